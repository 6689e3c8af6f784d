/* CRC-16/IBM-3740: polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR; of "123456789" it is 0x29B1
 * (WIRE_FORMAT.md section 2). It goes high byte first; of data and its own CRC it is 0. */
#ifndef BIOBOT_CRC_H
#define BIOBOT_CRC_H

#include <stdint.h>

uint16_t bb_crc16(const uint8_t *data, uint8_t length);

#endif
