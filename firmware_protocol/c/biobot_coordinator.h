/* The reference coordinator firmware, without its chip: native dialect, WIRE_FORMAT.md sections 2 to 4.
 *
 * There is one coordinator in a program; its memory is static. A port's main loop is
 *
 *     bb_coordinator_start();
 *     for (;;) {
 *         while (a byte came over the serial line) bb_coordinator_uart_received(&byte, 1);
 *         if (the radio heard a payload) bb_coordinator_radio_received(...);   false: let the radio not acknowledge it, or drop it
 *         if (the radio is done with a payload) bb_coordinator_radio_sent(...);
 *         bb_coordinator_poll();
 *         sleep until an interrupt, or until bb_coordinator_next_deadline;
 *     }
 *
 * None of these may be called from an interrupt, nor from a function of bb_port.h.
 */
#ifndef BIOBOT_COORDINATOR_H
#define BIOBOT_COORDINATOR_H

#include "bb_port.h"
#include "biobot_codec.h"

/* major << 8 | minor */
#ifndef BB_COORDINATOR_FIRMWARE
#define BB_COORDINATOR_FIRMWARE 0x0100u
#endif

/* Memory [B] for what waits until the base station confirms it; a heard payload takes its length and 6 more. */
#ifndef BB_COORDINATOR_QUEUE_SIZE
#define BB_COORDINATOR_QUEUE_SIZE 4096u
#endif

/* Payloads that the radio may hold at once; one more is answered with BB_RADIO_QUEUE_FULL. */
#ifndef BB_COORDINATOR_RADIO_QUEUE
#define BB_COORDINATOR_RADIO_QUEUE 16u
#endif

/* Longest frame [B] that the coordinator writes: 62 of an envelope, 4 of the link, 2 of CRC, 1 of stuffing, 2 delimiters. */
#define BB_COORDINATOR_FRAME_SIZE 71u

/* What became of a radio payload (WIRE_FORMAT.md 4.4). */
enum bb_radio_status {
    BB_RADIO_SENT = 0,
    BB_RADIO_NO_ACK = 1,
    BB_RADIO_CHANNEL_BUSY = 2,
    BB_RADIO_UNKNOWN_ADDRESS = 3,
    BB_RADIO_QUEUE_FULL = 4,
    BB_RADIO_TOO_LONG = 5,
    BB_RADIO_OTHER = 255
};

enum bb_log_level { BB_LOG_DEBUG = 0, BB_LOG_INFO = 1, BB_LOG_WARNING = 2, BB_LOG_ERROR = 3 };

/* What came in and was of no use, and what had no room; for a debugger and for tests. All modulo 2^16. */
struct bb_coordinator_counters {
    uint16_t bad_frames;       /* bad CRC, bad stuffing, too short, too long */
    uint16_t bad_envelopes;    /* unknown type, length or value; wrong direction */
    uint16_t refused_payloads; /* from the radio, for want of room */
    uint16_t lost_reports;     /* joined nodes and log lines, for want of room */
};

/* Begin anew, knowing no session: asks the base station for one, and says hello in the first. */
void bb_coordinator_start(void);

/* Bytes from the serial line, cut anywhere. */
void bb_coordinator_uart_received(const uint8_t *bytes, uint16_t length);

/* A payload from the air, 0 to 57 bytes. False: there is no room, nothing was taken; the backpack repeats what is not acknowledged. */
bool bb_coordinator_radio_received(uint16_t source, int8_t rssi_dbm, uint8_t lqi, const uint8_t *payload, uint8_t length);

/* What became of a payload that bb_port_radio_send took: a bb_radio_status. */
void bb_coordinator_radio_sent(uint16_t handle, uint8_t status);

/* A node has joined; EUI-64 lowest byte first. False: no room, not told. */
bool bb_coordinator_node_joined(uint16_t address, const uint8_t eui64[8]);

/* A line for the base station's log: a number of the port's choice and up to 58 bytes of UTF-8. False: no room, or text too long. */
bool bb_coordinator_log(uint8_t level, uint16_t code, const char *text, uint8_t length);

/* Write what is due, as far as the serial line has room. */
void bb_coordinator_poll(void);

/* When bb_coordinator_poll has something to do by the clock alone; false: not before something comes in. */
bool bb_coordinator_next_deadline(uint32_t *at_ms);

/* A base station is connected. */
bool bb_coordinator_is_open(void);

const struct bb_coordinator_counters *bb_coordinator_counters(void);

#endif
