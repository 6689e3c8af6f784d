/* The codec on any octets as uplink, downlink and envelope: what decodes, encodes again, and what was encoded says the same when decoded.
 *
 * The first octet chooses, and whether the CRC is made good first: noise alone would hardly ever pass it.
 */
#include "biobot_codec.h"
#include "biobot_crc.h"
#include "fuzz_input.h"

#include <string.h>

#define KINDS 3

static uint8_t decode(uint8_t kind, const uint8_t *octets, uint8_t length, void *message)
{
    switch (kind) {
    case 0:
        return bb_decode_uplink(octets, length, message);
    case 1:
        return bb_decode_downlink(octets, length, message);
    default:
        return bb_decode_envelope(octets, length, message);
    }
}

static uint8_t encode(uint8_t kind, const void *message, uint8_t *octets, uint8_t size)
{
    switch (kind) {
    case 0:
        return bb_encode_uplink(message, octets, size);
    case 1:
        return bb_encode_downlink(message, octets, size);
    default:
        return bb_encode_envelope(message, octets, size);
    }
}

union any {
    struct bb_uplink uplink;
    struct bb_downlink downlink;
    struct bb_envelope envelope;
};

/* A block that is too small is never overrun. */
static void encode_into(uint8_t kind, const union any *message, uint8_t size)
{
    uint8_t *small = malloc(size ? size : 1);
    LAW(small != NULL);
    LAW(encode(kind, message, small, size) == 0);
    free(small);
}

static void check(uint8_t kind, const uint8_t *octets, uint8_t length, uint8_t choice)
{
    uint8_t again[UINT8_MAX], third[UINT8_MAX];
    union any *message = malloc(sizeof *message), *other = malloc(sizeof *other);
    LAW(message != NULL && other != NULL);
    memset(message, 0xA5, sizeof *message); /* what is not written must not be read */
    memset(other, 0x5A, sizeof *other);
    uint8_t fault = decode(kind, octets, length, message);
    LAW(fault <= BB_BAD_VALUE);
    if (fault == BB_OK) {
        uint8_t n = encode(kind, message, again, UINT8_MAX);
        /* A newer peer's appended fields are left out, an older one's are filled in; the same meaning stays. */
        LAW(n != 0);
        LAW(kind == 2 || n <= BB_MAX_RADIO_PAYLOAD);
        LAW(decode(kind, again, n, other) == BB_OK);
        LAW(encode(kind, other, third, UINT8_MAX) == n && memcmp(again, third, n) == 0);
        encode_into(kind, message, (uint8_t)(n - 1));
        encode_into(kind, message, (uint8_t)(choice % n));
    }
    free(message);
    free(other);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input input = {data, size};
    uint8_t choice = take_u8(&input), length;
    uint8_t *octets = take_block(&input, UINT8_MAX, &length);
    if (choice & 0x80 && length >= 2) {
        if (length > BB_MAX_RADIO_PAYLOAD) length = BB_MAX_RADIO_PAYLOAD;
        uint16_t crc = bb_crc16(octets, (uint8_t)(length - 2));
        octets[length - 2] = (uint8_t)(crc >> 8);
        octets[length - 1] = (uint8_t)(crc & 0xFF);
    }
    check(choice % KINDS, octets, length, choice);
    free(octets);
    return 0;
}
