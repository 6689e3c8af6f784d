#include "bb_bench_encounters.h"

#include <stdbool.h>

#include "biobot_codec.h"

#define SPREAD_MS 4096u      /* within its period a meeting begins up to this late */
#define SHORTEST_MS 1000u
#define LENGTHS_MS 2048u
#define OTHER_SIDE_MS 40u    /* the backpack with the higher number senses a meeting this much later, and to its end */

/* The finalizer of MurmurHash3 (A. Appleby, public domain): every bit of x moves every bit of the result. */
uint32_t bb_bench_mix(uint32_t x)
{
    x ^= x >> 16;
    x *= 0x85EBCA6Bu;
    x ^= x >> 13;
    x *= 0xC2B2AE35u;
    x ^= x >> 16;
    return x;
}

void bb_bench_report(uint8_t node, uint16_t index, struct bb_encounter_batch_entry *entry)
{
    uint32_t meeting = index / (BB_BENCH_NODES - 1u);
    uint8_t peer = (uint8_t)(index % (BB_BENCH_NODES - 1u) + 1u);
    uint8_t low, high;
    uint32_t draw, start_ms, duration_ms;
    if (peer >= node) {
        peer++;
    }
    low = node < peer ? node : peer;
    high = node < peer ? peer : node;
    draw = bb_bench_mix(BB_BENCH_SEED << 24 ^ meeting << 16 ^ (uint32_t)low << 8 ^ high);
    start_ms = BB_BENCH_FIRST_MS + meeting * BB_BENCH_PERIOD_MS + draw % SPREAD_MS;
    duration_ms = SHORTEST_MS + (draw >> 12) % LENGTHS_MS;
    if (node == high) {
        start_ms += OTHER_SIDE_MS;
        duration_ms -= OTHER_SIDE_MS;
    }
    entry->peer = peer;
    entry->start_ms = start_ms + node * BB_BENCH_SKEW_MS;
    entry->duration_high = bb_encounter_duration_high(duration_ms, false);
    entry->duration_low = (uint16_t)(duration_ms & 0xFFFFu);
    entry->rssi_dbm = (int8_t)(-45 - (int8_t)((draw >> 24) % 40u));
}
