/* One virtual backpack: the reference message side (biobot_backpack.h), and an insect, a battery and electrodes that are not there.
 *
 * Its memory is meant to outlive a reset of the board, at any instant: see bb_bench_backpack_wake. Times are ticks of its own clock.
 */
#ifndef BB_BENCH_BACKPACK_H
#define BB_BENCH_BACKPACK_H

#include <stdbool.h>
#include <stdint.h>

#include "biobot_backpack.h"

struct bb_bench_backpack {
    struct bb_backpack messages;
    struct bb_configure configuration; /* in force; its token is the newest one's */
    uint32_t mode_since_ms;
    uint32_t hold_until_ms;
    uint32_t next_batch_ms;
    uint32_t answered_command;
    uint32_t answered_at_ms;
    uint16_t next_report;
    uint16_t n_draws;
    uint8_t mode;
    uint8_t cause;
    uint8_t answer;
    uint8_t configuration_result;
    bool is_holding;
    bool owes_limits, owes_status, owes_answer, owes_configuration;
};

void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms);

/* Go on after the program was cut off anywhere and has begun again. */
void bb_bench_backpack_wake(struct bb_bench_backpack *backpack);

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, uint32_t now_ms);

/* Write the payload that goes on the air now; returns its length, 0: none. */
uint8_t bb_bench_backpack_speak(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD]);

#endif
