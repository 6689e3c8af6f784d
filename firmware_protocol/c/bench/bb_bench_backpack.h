/* One virtual backpack: the reference message side (biobot_backpack.h), and an insect, a battery and electrodes that are not there.
 *
 * Its memory is meant to outlive a reset of the board, at any instant: see bb_bench_backpack_wake. Times are ticks of its own clock.
 */
#ifndef BB_BENCH_BACKPACK_H
#define BB_BENCH_BACKPACK_H

#include <stdbool.h>
#include <stdint.h>

#include "biobot_backpack.h"

/* Commands that may wait for the end of a train (WIRE_FORMAT.md section 6.8). */
#define BB_BENCH_QUEUE 4u

struct bb_bench_waiting {
    struct bb_stimulate command;
    uint32_t received_ms;
};

struct bb_bench_backpack {
    struct bb_backpack messages;
    struct bb_bench_waiting queue[BB_BENCH_QUEUE]; /* oldest first */
    uint32_t mode_since_ms;
    uint32_t hold_until_ms;
    uint32_t train_until_ms;
    uint32_t next_batch_ms;
    uint16_t report_period_ms; /* all of its configuration: it senses continuously */
    uint16_t configuration_token;
    uint16_t next_report;
    uint16_t n_draws;
    uint8_t mode;
    uint8_t cause;
    uint8_t configuration_result;
    uint8_t n_queued;
    bool is_holding;
    bool is_held_still; /* by a stop */
    bool owes_status, owes_configuration;
};

void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms);

/* Go on after the program was cut off anywhere and has begun again. */
void bb_bench_backpack_wake(struct bb_bench_backpack *backpack);

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, bool is_broadcast,
                            uint32_t now_ms);

/* Write the payload that goes on the air now; returns its length, 0: none. */
uint8_t bb_bench_backpack_speak(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD]);

#endif
