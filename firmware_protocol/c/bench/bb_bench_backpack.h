/* One virtual backpack: what it has to say, until it is acknowledged, and how it obeys (WIRE_FORMAT.md sections 5 and 6).
 *
 * Its memory is meant to outlive a reset of the coordinator, at any instant: see bb_bench_backpack_wake.
 */
#ifndef BB_BENCH_BACKPACK_H
#define BB_BENCH_BACKPACK_H

#include <stdbool.h>
#include <stdint.h>

#include "biobot_codec.h"

#define BB_BENCH_WINDOW 16u    /* messages under way; the wire format allows 33 */
#define BB_BENCH_REMEMBERED 8u /* commands */

/* Limits of this backpack, as it tells and keeps them. */
#define BB_BENCH_MAX_FREQUENCY_HZ 150u
#define BB_BENCH_MAX_PULSE_WIDTH_US 10000u
#define BB_BENCH_MAX_AMPLITUDE_MV 4000u
#define BB_BENCH_MAX_DURATION_MS 1000u

enum bb_bench_mode { BB_BENCH_CRW = 0, BB_BENCH_S = 1 };
enum bb_bench_cause { BB_BENCH_NATURAL = 0, BB_BENCH_COMMAND = 1 };

struct bb_bench_message {
    volatile uint8_t is_kept; /* written last: a message is there whole or not at all */
    uint8_t length;           /* of the encoded payload, whose header is renewed for each copy */
    uint8_t n_sent;
    uint16_t sequence;
    uint32_t due_ms;
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
};

struct bb_bench_command {
    uint32_t command;
    uint32_t executed_ms;
    uint8_t result;
};

struct bb_bench_backpack {
    struct bb_bench_message messages[BB_BENCH_WINDOW];
    struct bb_bench_command commands[BB_BENCH_REMEMBERED];
    struct bb_configure configuration;
    uint32_t mode_since_ms;
    uint32_t hold_until_ms;
    uint32_t next_batch_ms;
    uint32_t asked_at_ms; /* tick of the time sync request */
    uint16_t asked_token;
    uint16_t next_sequence;
    uint16_t next_report;
    uint16_t n_draws;
    uint8_t node;
    uint8_t boot;
    uint8_t mode;
    uint8_t cause;
    uint8_t next_command;
    bool is_holding;
    bool is_asked_time;
    bool owes_hello, owes_limits, owes_status, owes_configuration;
    uint16_t configuration_token;
    uint8_t configuration_result;
    struct bb_stimulate_reply reply;
    bool owes_reply;
};

/* Times are ticks of this backpack's own clock. */
void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms);

/* Go on after the program was cut off anywhere and has begun again. */
void bb_bench_backpack_wake(struct bb_bench_backpack *backpack);

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, uint32_t now_ms);

/* Write the next payload that is due and return its length; 0: none is. Call bb_bench_backpack_was_sent with its ticket, or not at all:
 * then it stays due. */
uint8_t bb_bench_backpack_next(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD], uint8_t *ticket);
void bb_bench_backpack_was_sent(struct bb_bench_backpack *backpack, uint8_t ticket, uint32_t now_ms);

/* All that it had to report has been acknowledged. */
bool bb_bench_backpack_is_level(const struct bb_bench_backpack *backpack);

#endif
