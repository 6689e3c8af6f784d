#include "biobot_crc.h"

/* Eight steps of the shift register at once. The polynomial x^16 + x^12 + x^5 + 1 has so few terms that the remainder of a byte is
 * three shifts of (byte xor its high nibble): no table (512 bytes for a byte, 32 for a nibble) and no loop over bits. */
uint16_t bb_crc16(const uint8_t *data, uint8_t length)
{
    uint16_t crc = 0xFFFFu;
    while (length != 0u) {
        uint16_t x = (uint16_t)(((unsigned)crc >> 8) ^ *data);
        x = (uint16_t)(x ^ (x >> 4));
        crc = (uint16_t)(((unsigned)crc << 8) ^ ((unsigned)x << 12) ^ ((unsigned)x << 5) ^ x);
        data++;
        length--;
    }
    return crc;
}
