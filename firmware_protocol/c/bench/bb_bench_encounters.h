/* Which virtual backpacks met when: a function of the seed, so that a test knows what must arrive.
 *
 * Backpacks have the numbers 1 to BB_BENCH_NODES. Every two of them met BB_BENCH_MEETINGS times before the board was switched on; the m-th
 * time in the m-th period of BB_BENCH_PERIOD_MS after BB_BENCH_FIRST_MS, on a time that all share ("bench time"). Each side reports what it
 * sensed of it on a clock of its own, which is ahead of bench time by BB_BENCH_SKEW_MS for each number. tests/e2e/bench_encounters.py says the
 * same in Python.
 */
#ifndef BB_BENCH_ENCOUNTERS_H
#define BB_BENCH_ENCOUNTERS_H

#include <stdint.h>

#include "biobot_layouts.h"

#ifndef BB_BENCH_SEED
#define BB_BENCH_SEED 1u
#endif

#define BB_BENCH_NODES 12u
#define BB_BENCH_MEETINGS 40u
#define BB_BENCH_FIRST_MS 50000u
#define BB_BENCH_PERIOD_MS 15000u
#define BB_BENCH_START_MS 1000000u /* bench time when the board is switched on; all meetings are over */
#define BB_BENCH_SKEW_MS 37000u
#define BB_BENCH_BATCH_MS 60u         /* a backpack says a batch no sooner after the one before */
#define BB_BENCH_EUI64_1 0xBEu        /* second octet of a backpack's EUI-64; the first is its number, the others are 0 */

/* Reports of one backpack in all. */
#define BB_BENCH_REPORTS (BB_BENCH_MEETINGS * (BB_BENCH_NODES - 1u))

uint32_t bb_bench_mix(uint32_t x);

/* The index-th report, 0 to BB_BENCH_REPORTS - 1, of backpack number `node`. */
void bb_bench_report(uint8_t node, uint16_t index, struct bb_encounter_batch_entry *entry);

#endif
