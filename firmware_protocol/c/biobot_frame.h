/* Native framing: COBS between zero delimiters, with a CRC-16 (WIRE_FORMAT.md section 2). */
#ifndef BIOBOT_FRAME_H
#define BIOBOT_FRAME_H

#include <stdbool.h>
#include <stdint.h>

#define BB_MAX_FRAME_BODY 250u

/* What a frame has around its body on the line: two delimiters, one byte of stuffing, two of CRC. */
#define BB_FRAME_OVERHEAD 5u

enum bb_frame_result {
    BB_FRAME_NONE = 0, /* nothing ended with this byte */
    BB_FRAME_BODY = 1,
    BB_FRAME_BAD_CRC = 2,
    BB_FRAME_BAD_STUFFING = 3,
    BB_FRAME_TOO_SHORT = 4,
    BB_FRAME_TOO_LONG = 5
};

/* A damaged frame costs itself alone: decoding starts anew at the next delimiter. After BB_FRAME_BODY the body is
 * body[0 .. length), until the next call. */
struct bb_frame_decoder {
    uint8_t body[BB_MAX_FRAME_BODY + 2u];
    uint8_t length;
    uint8_t n_encoded;  /* bytes since the delimiter, up to one too many */
    uint8_t block_left; /* bytes that the block has still to bring */
    bool is_zero_due;   /* a zero stands between this block and the next, if there is one */
};

void bb_frame_decoder_start(struct bb_frame_decoder *decoder);

/* Take the next byte from the line; returns a bb_frame_result. */
uint8_t bb_frame_decode(struct bb_frame_decoder *decoder, uint8_t byte);

/* Make a frame in place. The body, 1 to BB_MAX_FRAME_BODY bytes, stands at frame + 2; frame has room for length + BB_FRAME_OVERHEAD.
 * Returns the frame's size on the line, delimiters included; 0: the length is out of range, frame is as it was. */
uint8_t bb_frame_encode(uint8_t *frame, uint8_t length);

#endif
