#include "biobot_frame.h"

#include "biobot_crc.h"

#define MAX_ENCODED (BB_MAX_FRAME_BODY + 3u) /* body, CRC and one COBS code; needs no second code below 254 */
#define LONG_CODE 0xFFu                      /* a block of 254 bytes, with no zero behind it */

void bb_frame_decoder_start(struct bb_frame_decoder *decoder)
{
    decoder->length = 0;
    decoder->n_encoded = 0;
    decoder->block_left = 0;
    decoder->is_zero_due = false;
}

static uint8_t end_frame(struct bb_frame_decoder *decoder)
{
    uint8_t result;
    if (decoder->n_encoded == 0u || decoder->n_encoded > MAX_ENCODED) {
        result = BB_FRAME_NONE; /* two delimiters in a row; or BB_FRAME_TOO_LONG, told already */
    } else if (decoder->block_left != 0u) {
        result = BB_FRAME_BAD_STUFFING;
    } else if (decoder->length < 3u) {
        result = BB_FRAME_TOO_SHORT;
    } else if (bb_crc16(decoder->body, decoder->length) != 0u) {
        result = BB_FRAME_BAD_CRC;
    } else {
        decoder->length = (uint8_t)(decoder->length - 2u);
        result = BB_FRAME_BODY;
    }
    decoder->n_encoded = 0;
    decoder->block_left = 0;
    decoder->is_zero_due = false;
    return result;
}

uint8_t bb_frame_decode(struct bb_frame_decoder *decoder, uint8_t byte)
{
    if (byte == 0u) {
        return end_frame(decoder);
    }
    if (decoder->n_encoded >= MAX_ENCODED) {
        /* All up to the next delimiter is dropped, and told once. */
        uint8_t result = decoder->n_encoded == MAX_ENCODED ? BB_FRAME_TOO_LONG : BB_FRAME_NONE;
        decoder->n_encoded = MAX_ENCODED + 1u;
        return result;
    }
    if (decoder->n_encoded == 0u) {
        decoder->length = 0; /* of the body before, which was the caller's until now */
    }
    /* Every byte but the first code gives one decoded byte at most, so MAX_ENCODED - 1 of them fit the body. */
    decoder->n_encoded++;
    if (decoder->block_left != 0u) {
        decoder->block_left--;
        decoder->body[decoder->length++] = byte;
    } else {
        if (decoder->is_zero_due) {
            decoder->body[decoder->length++] = 0;
        }
        decoder->block_left = (uint8_t)(byte - 1u);
        decoder->is_zero_due = byte != LONG_CODE;
    }
    return BB_FRAME_NONE;
}

uint8_t bb_frame_encode(uint8_t *frame, uint8_t length)
{
    uint16_t crc;
    uint8_t at;
    uint8_t next;
    if (length == 0u || length > BB_MAX_FRAME_BODY) {
        return 0;
    }
    crc = bb_crc16(frame + 2, length);
    frame[length + 2u] = (uint8_t)(crc >> 8);
    frame[length + 3u] = (uint8_t)(crc & 0xFFu);
    next = (uint8_t)(length + 4u);
    frame[next] = 0;
    /* Each zero becomes the distance to the next one, from the last to the code in front. */
    frame[1] = 0;
    for (at = (uint8_t)(next - 1u); at != 0u; at--) {
        if (frame[at] == 0u) {
            frame[at] = (uint8_t)(next - at);
            next = at;
        }
    }
    frame[0] = 0;
    return (uint8_t)(length + BB_FRAME_OVERHEAD);
}
