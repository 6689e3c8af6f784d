/* What the coordinator firmware asks of the chip it runs on; one file of a port provides all of it (docs/firmware.md).
 *
 * Nothing here waits. The core calls these from its main loop only, never from an interrupt; a port calls the core's functions
 * (biobot_coordinator.h) from the main loop only, too. Handlers of interrupts fill and empty the port's own rings.
 */
#ifndef BB_PORT_H
#define BB_PORT_H

#include <stdbool.h>
#include <stdint.h>

/* The network that the coordinator runs. In a wish, BB_PAN_LEAVE, BB_CHANNEL_LEAVE and BB_JOIN_LEAVE stand for "as it is". */
struct bb_network {
    uint16_t pan_id;
    uint8_t channel;       /* 11 to 26 */
    uint8_t permit_join_s; /* how much longer nodes may join [s]; 0: closed; 254: until told otherwise */
};

#define BB_PAN_LEAVE 0xFFFFu
#define BB_CHANNEL_LEAVE 0u
#define BB_JOIN_LEAVE 255u

enum bb_network_result { BB_NETWORK_DONE = 0, BB_NETWORK_BAD = 1, BB_NETWORK_NOT_SUPPORTED = 2 };

/* Milliseconds since the start; wraps at 2^32. */
uint32_t bb_port_now_ms(void);

/* How many bytes bb_port_uart_write takes now. The core writes frames whole: a port that never has BB_COORDINATOR_FRAME_SIZE
 * bytes of room sends nothing. */
uint16_t bb_port_uart_room(void);

/* Take bytes for the serial line, all of them; never more than the room. */
void bb_port_uart_write(const uint8_t *bytes, uint8_t length);

/* Copy a radio payload (1 to 57 bytes) and send it to a short address (0xFFFF: all). True: taken, and bb_coordinator_radio_sent
 * will be called once with this handle, at any time after this call has returned. False: the radio has no room, nothing was taken. */
bool bb_port_radio_send(uint16_t handle, uint16_t destination, const uint8_t *payload, uint8_t length);

/* Tell the network in force. */
void bb_port_network(struct bb_network *network);

/* Change the network; the core has checked the channel. A bb_network_result; after any but DONE all is as it was. */
uint8_t bb_port_set_network(const struct bb_network *wish);

/* The coordinator's EUI-64, lowest byte first. */
void bb_port_eui64(uint8_t eui64[8]);

#endif
