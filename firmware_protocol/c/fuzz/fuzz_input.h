/* What the fuzzing targets share: an input that is read as it is wanted, and an assertion that no flag switches off. */
#ifndef FUZZ_INPUT_H
#define FUZZ_INPUT_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#define LAW(claim)     \
    do {               \
        if (!(claim))  \
            abort();   \
    } while (0)

struct input {
    const uint8_t *at;
    size_t left;
};

/* The next octet; 0 when the input is spent. */
static inline uint8_t take_u8(struct input *input)
{
    if (input->left == 0) return 0;
    input->left--;
    return *input->at++;
}

static inline uint16_t take_u16(struct input *input)
{
    uint16_t low = take_u8(input);
    return (uint16_t)(low | (uint16_t)(take_u8(input) << 8));
}

/* Up to `most` octets as a block of the heap of just their number, so that the address sanitizer sees each read past its end. */
static inline uint8_t *take_block(struct input *input, uint8_t most, uint8_t *length)
{
    size_t n = most < input->left ? most : input->left;
    uint8_t *block = malloc(n ? n : 1);
    LAW(block != NULL);
    for (size_t i = 0; i < n; i++) block[i] = take_u8(input);
    *length = (uint8_t)n;
    return block;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#endif
