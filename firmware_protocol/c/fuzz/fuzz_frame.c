/* The frame decoder on any octets: results are in range, a body that comes out goes in again, and a sound frame behind noise is found. */
#include "biobot_frame.h"
#include "fuzz_input.h"

#include <string.h>

#define LONGEST_RUN (BB_MAX_FRAME_BODY + 3u) /* WIRE_FORMAT.md section 2 */

static uint8_t encoded[BB_MAX_FRAME_BODY + BB_FRAME_OVERHEAD];

static void decode_whole(const uint8_t *octets, size_t n, const uint8_t *body, uint8_t length)
{
    struct bb_frame_decoder decoder;
    size_t n_bodies = 0;
    bb_frame_decoder_start(&decoder);
    for (size_t i = 0; i < n; i++) {
        uint8_t result = bb_frame_decode(&decoder, octets[i]);
        LAW(result == BB_FRAME_NONE || result == BB_FRAME_BODY);
        if (result != BB_FRAME_BODY) continue;
        n_bodies++;
        LAW(decoder.length == length && memcmp(decoder.body, body, length) == 0);
    }
    LAW(n_bodies == 1);
}

static void encode_again(const uint8_t *body, uint8_t length)
{
    uint8_t *frame = malloc((size_t)length + BB_FRAME_OVERHEAD);
    LAW(frame != NULL);
    memcpy(frame + 2, body, length);
    uint8_t n = bb_frame_encode(frame, length);
    LAW(n == length + BB_FRAME_OVERHEAD && frame[0] == 0 && frame[n - 1] == 0);
    LAW(memchr(frame + 1, 0, n - 2u) == NULL);
    decode_whole(frame, n, body, length);
    free(frame);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct bb_frame_decoder *decoder = malloc(sizeof *decoder);
    LAW(decoder != NULL);
    bb_frame_decoder_start(decoder);
    size_t run = 0; /* octets since the last delimiter */
    for (size_t i = 0; i < size; i++) {
        uint8_t result = bb_frame_decode(decoder, data[i]);
        run = data[i] ? run + 1 : 0;
        LAW(result <= BB_FRAME_TOO_LONG);
        LAW(run == 0 || (result == BB_FRAME_TOO_LONG) == (run == LONGEST_RUN + 1)); /* told once, at once */
        LAW(run == 0 || result == BB_FRAME_NONE || result == BB_FRAME_TOO_LONG);
        if (result == BB_FRAME_BODY) {
            LAW(decoder->length >= 1 && decoder->length <= BB_MAX_FRAME_BODY);
            encode_again(decoder->body, decoder->length);
        }
    }
    /* Whatever came before it, a sound frame between delimiters is found, and alone. */
    static const uint8_t sound[] = {1, 0x34, 0x12, 0, 1};
    memcpy(encoded + 2, sound, sizeof sound);
    uint8_t n = bb_frame_encode(encoded, sizeof sound), n_found = 0;
    for (uint8_t i = 0; i < n; i++) {
        if (bb_frame_decode(decoder, encoded[i]) == BB_FRAME_BODY && i + 1 == n) {
            LAW(decoder->length == sizeof sound && memcmp(decoder->body, sound, sizeof sound) == 0);
            n_found++;
        }
    }
    LAW(n_found == 1);
    /* The whole input as a body, where it fits one. */
    if (size >= 1 && size <= BB_MAX_FRAME_BODY) encode_again(data, (uint8_t)size);
    free(decoder);
    return 0;
}
