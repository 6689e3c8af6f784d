/* A radio with backpacks behind it, for boards that have none: it provides the radio's functions of bb_port.h. */
#ifndef BB_BENCH_RADIO_H
#define BB_BENCH_RADIO_H

#include <stdint.h>

/* Where the backpacks live: memory that a reset of the board leaves alone, or they would all start again with it. */
#ifndef BB_BENCH_KEPT
#define BB_BENCH_KEPT __attribute__((section(".kept")))
#endif

/* Begin, or go on where the board was reset. */
void bb_bench_start(uint32_t now_ms);

/* Move payloads between the coordinator and the backpacks; to be called every few milliseconds. */
void bb_bench_poll(uint32_t now_ms);

#endif
