/* A chip that is not there: the coordinator's port in the memory of a test or a fuzzer. All state is static; bb_host_start clears it. */
#ifndef BB_HOST_PORT_H
#define BB_HOST_PORT_H

#include "../../bb_port.h"
#include "../../biobot_frame.h"

#define BB_HOST_UART_SIZE 65536u
#define BB_HOST_RADIO_SIZE 64u

/* A payload that the core gave to the radio. */
struct bb_host_sent {
    uint16_t handle;
    uint16_t destination;
    uint8_t length;
    uint8_t payload[57];
};

void bb_host_start(void);
void bb_host_set_now_ms(uint32_t now_ms);

/* How many bytes the serial line takes until the next call; at most what BB_HOST_UART_SIZE leaves. */
void bb_host_set_uart_room(uint16_t room);

/* Hand out what was written to the serial line, at most size bytes; returns how many. */
uint16_t bb_host_take_uart(uint8_t *bytes, uint16_t size);

/* How many payloads the radio holds before it says that it has no room; at most BB_HOST_RADIO_SIZE. */
void bb_host_set_radio_room(uint8_t n_payloads);

/* Hand out the oldest payload given to the radio; false: there is none. */
bool bb_host_take_sent(struct bb_host_sent *sent);

/* Decode many bytes at once. For each body and fault: the bb_frame_result, the body's length, the body. Returns the octets written to
 * results: a fault takes at least one byte of input and a body as many as it has, so 3 * length + BB_MAX_FRAME_BODY are enough. */
uint32_t bb_host_decode_frames(struct bb_frame_decoder *decoder, const uint8_t *bytes, uint32_t length, uint8_t *results);

#endif
