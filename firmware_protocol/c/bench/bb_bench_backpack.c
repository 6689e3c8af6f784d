#include "bb_bench_backpack.h"

#include "bb_bench_encounters.h"
#include "biobot_crc.h"

#define FIRST_BOOT 1u
#define BATCH_PERIOD_MS 60u
#define ENTRIES_PER_BATCH 4u
#define FIRST_RETRY_MS 1000u /* WIRE_FORMAT.md section 5.1 */
#define MAX_DOUBLINGS 5u     /* up to 32 s, cut at the next */
#define MAX_RETRY_MS 30000u
#define TIME_SYNC_TICKET BB_BENCH_WINDOW
#define BATTERY_MV 3700u

#define FIRMWARE 0x0100u
/* Capability bits (WIRE_FORMAT.md section 5.2). */
#define CAN_BE_STIMULATED 1u
#define TAKES_CONFIGURE 4u

static bool is_due(uint32_t at_ms, uint32_t now_ms)
{
    return now_ms - at_ms < 0x80000000u;
}

void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms)
{
    static const struct bb_configure configuration = {0, 0, -85, -90, 0, BATCH_PERIOD_MS};
    *backpack = (struct bb_bench_backpack){0};
    backpack->node = node;
    backpack->boot = FIRST_BOOT;
    backpack->mode = BB_BENCH_CRW;
    backpack->mode_since_ms = now_ms;
    backpack->next_batch_ms = now_ms;
    backpack->configuration = configuration;
    backpack->owes_hello = backpack->owes_limits = backpack->owes_status = true;
}

void bb_bench_backpack_wake(struct bb_bench_backpack *backpack)
{
    uint8_t i;
    for (i = 0; i < BB_BENCH_WINDOW; i++) {
        /* A message may have been kept and its number not yet counted. */
        if (backpack->messages[i].is_kept && backpack->messages[i].sequence == backpack->next_sequence) {
            backpack->next_sequence++;
        }
    }
}

/* --- what it has to say ------------------------------------------------------------------------------------------------------ */

static struct bb_bench_message *free_message(struct bb_bench_backpack *backpack)
{
    struct bb_bench_message *found = 0;
    uint8_t i;
    for (i = 0; i < BB_BENCH_WINDOW; i++) {
        struct bb_bench_message *one = &backpack->messages[i];
        if (!one->is_kept) {
            found = one;
        } else if ((uint16_t)(backpack->next_sequence - one->sequence) >= 32u) {
            return 0; /* the oldest number outstanding and the newest are at most 32 apart */
        }
    }
    return found;
}

/* Number a message and keep it; false: no room now. The header's time is written when it is sent. */
static bool keep(struct bb_bench_backpack *backpack, uint8_t type, struct bb_uplink *message, uint32_t now_ms)
{
    struct bb_bench_message *to = free_message(backpack);
    if (to == 0) {
        return false;
    }
    message->header.type = type;
    message->header.node = backpack->node;
    message->header.boot = backpack->boot;
    message->header.sequence = backpack->next_sequence;
    message->header.sent_ms = now_ms;
    to->length = bb_encode_uplink(message, to->payload, BB_MAX_RADIO_PAYLOAD);
    to->sequence = backpack->next_sequence;
    to->due_ms = now_ms;
    to->n_sent = 0;
    to->is_kept = 1;
    backpack->next_sequence++;
    return true;
}

static bool say_hello(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_hello *hello = &message.body.hello;
    hello->eui64[0] = backpack->node;
    hello->eui64[1] = 0xBE;
    hello->firmware = FIRMWARE;
    hello->beacon_period_ms = backpack->configuration.beacon_period_ms;
    hello->capabilities = CAN_BE_STIMULATED | TAKES_CONFIGURE;
    hello->newest_version = BB_PROTOCOL_VERSION;
    return keep(backpack, BB_TYPE_HELLO, &message, now_ms);
}

static bool say_limits(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_limits *limits = &message.body.limits;
    limits->channels = 0x0F;
    limits->waveforms = 0x01;
    limits->max_frequency_hz = BB_BENCH_MAX_FREQUENCY_HZ;
    limits->max_pulse_width_us = BB_BENCH_MAX_PULSE_WIDTH_US;
    limits->max_amplitude_mv = BB_BENCH_MAX_AMPLITUDE_MV;
    limits->max_duration_ms = BB_BENCH_MAX_DURATION_MS;
    limits->min_gap_ms = 0;
    limits->max_on_ms_per_minute = 60000u;
    limits->battery_mv = BATTERY_MV;
    limits->battery_empty_mv = 3000u;
    limits->encounter_capacity = BB_BENCH_REPORTS;
    return keep(backpack, BB_TYPE_LIMITS, &message, now_ms);
}

static bool say_status(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_status *status = &message.body.status;
    status->mode = backpack->mode;
    status->cause = backpack->cause;
    status->mode_since_ms = backpack->mode_since_ms;
    status->battery_mv = BATTERY_MV;
    status->buffered = (uint16_t)(BB_BENCH_REPORTS - backpack->next_report);
    return keep(backpack, BB_TYPE_STATUS, &message, now_ms);
}

static bool say_configuration(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_configuration_report *report = &message.body.configuration_report;
    report->token = backpack->configuration_token;
    report->result = backpack->configuration_result;
    report->beacon_period_ms = backpack->configuration.beacon_period_ms;
    report->rssi_enter_dbm = backpack->configuration.rssi_enter_dbm;
    report->rssi_exit_dbm = backpack->configuration.rssi_exit_dbm;
    report->gap_tolerance_ms = backpack->configuration.gap_tolerance_ms;
    report->report_period_ms = backpack->configuration.report_period_ms;
    return keep(backpack, BB_TYPE_CONFIGURATION_REPORT, &message, now_ms);
}

static bool say_reply(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    message.body.stimulate_reply = backpack->reply;
    return keep(backpack, BB_TYPE_STIMULATE_REPLY, &message, now_ms);
}

static void say_encounters(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_encounter_batch *batch = &message.body.encounter_batch;
    uint16_t index = backpack->next_report;
    if (index >= BB_BENCH_REPORTS || !is_due(backpack->next_batch_ms, now_ms)) {
        return;
    }
    while (batch->n_entries < ENTRIES_PER_BATCH && index < BB_BENCH_REPORTS) {
        bb_bench_report(backpack->node, index, &batch->entries[batch->n_entries]);
        batch->n_entries++;
        index++;
    }
    if (keep(backpack, BB_TYPE_ENCOUNTER_BATCH, &message, now_ms)) {
        backpack->next_report = index; /* cut off before this, the batch is said twice: nobody minds */
        backpack->next_batch_ms = now_ms + backpack->configuration.report_period_ms;
    }
}

static void say_what_is_owed(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    if (backpack->owes_hello && say_hello(backpack, now_ms)) {
        backpack->owes_hello = false;
    }
    if (backpack->owes_limits && say_limits(backpack, now_ms)) {
        backpack->owes_limits = false;
    }
    if (backpack->owes_reply && say_reply(backpack, now_ms)) {
        backpack->owes_reply = false;
    }
    if (backpack->owes_status && say_status(backpack, now_ms)) {
        backpack->owes_status = false;
    }
    if (backpack->owes_configuration && say_configuration(backpack, now_ms)) {
        backpack->owes_configuration = false;
    }
    say_encounters(backpack, now_ms);
}

/* Renew the time in the header of a copy, and with it the CRC. */
static void stamp(uint8_t *payload, uint8_t length, uint32_t now_ms)
{
    uint8_t i;
    uint16_t crc;
    for (i = 0; i < 4u; i++) {
        payload[8u + i] = (uint8_t)(now_ms >> (8u * i) & 0xFFu);
    }
    crc = bb_crc16(payload, (uint8_t)(length - 2u));
    payload[length - 2u] = (uint8_t)(crc >> 8);
    payload[length - 1u] = (uint8_t)(crc & 0xFFu);
}

static uint8_t answer_time(const struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t *payload)
{
    struct bb_uplink message = {0};
    message.header.type = BB_TYPE_TIME_SYNC_REPLY;
    message.header.node = backpack->node;
    message.header.boot = backpack->boot;
    message.header.sent_ms = now_ms;
    message.body.time_sync_reply.token = backpack->asked_token;
    message.body.time_sync_reply.received_ms = backpack->asked_at_ms;
    return bb_encode_uplink(&message, payload, BB_MAX_RADIO_PAYLOAD);
}

static void end_hold(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    if (!backpack->is_holding || !is_due(backpack->hold_until_ms, now_ms)) {
        return;
    }
    backpack->is_holding = false;
    if (backpack->mode == BB_BENCH_S) {
        backpack->mode = BB_BENCH_CRW;
        backpack->cause = BB_BENCH_NATURAL;
        backpack->mode_since_ms = now_ms;
        backpack->owes_status = true;
    }
}

uint8_t bb_bench_backpack_next(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD], uint8_t *ticket)
{
    uint8_t i, j;
    if (backpack->is_asked_time) {
        *ticket = TIME_SYNC_TICKET;
        return answer_time(backpack, now_ms, payload);
    }
    end_hold(backpack, now_ms);
    say_what_is_owed(backpack, now_ms);
    for (i = 0; i < BB_BENCH_WINDOW; i++) {
        struct bb_bench_message *one = &backpack->messages[i];
        if (one->is_kept && is_due(one->due_ms, now_ms)) {
            for (j = 0; j < one->length; j++) {
                payload[j] = one->payload[j];
            }
            stamp(payload, one->length, now_ms);
            *ticket = i;
            return one->length;
        }
    }
    return 0;
}

void bb_bench_backpack_was_sent(struct bb_bench_backpack *backpack, uint8_t ticket, uint32_t now_ms)
{
    struct bb_bench_message *one;
    uint32_t wait_ms, draw;
    if (ticket == TIME_SYNC_TICKET) {
        backpack->is_asked_time = false;
        return;
    }
    one = &backpack->messages[ticket];
    wait_ms = FIRST_RETRY_MS << (one->n_sent < MAX_DOUBLINGS ? one->n_sent : MAX_DOUBLINGS);
    if (wait_ms > MAX_RETRY_MS) {
        wait_ms = MAX_RETRY_MS;
    }
    draw = bb_bench_mix((uint32_t)backpack->node << 16 ^ backpack->n_draws++);
    one->due_ms = now_ms + wait_ms / 4u * 3u + draw % (wait_ms / 2u); /* 0.75 to 1.25 of it */
    if (one->n_sent < MAX_DOUBLINGS) {
        one->n_sent++;
    }
}

bool bb_bench_backpack_is_level(const struct bb_bench_backpack *backpack)
{
    uint8_t i;
    for (i = 0; i < BB_BENCH_WINDOW; i++) {
        if (backpack->messages[i].is_kept) {
            return false;
        }
    }
    return backpack->next_report >= BB_BENCH_REPORTS;
}
