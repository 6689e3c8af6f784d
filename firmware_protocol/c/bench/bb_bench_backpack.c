#include "bb_bench_backpack.h"

#include "bb_bench_encounters.h"

#define FIRST_BOOT 1u
#define FIRMWARE 0x0100u
#define BATTERY_MV 3700u
#define BATTERY_EMPTY_MV 3000u
#define ENTRIES_PER_BATCH 4u
#define SEQUENCE_AT 6u /* in a payload's header (WIRE_FORMAT.md section 5.1) */
#define MOST_BIPHASIC 500000u /* frequency_hz * pulse_width_us (section 6.5): two phases to a period */
#define OWN_CHANNEL 255u
#define SYMMETRIC_BIPHASIC 0u

/* Capability bits (WIRE_FORMAT.md section 5.2). */
#define CAN_BE_STIMULATED 1u
#define TAKES_CONFIGURE 4u

/* Limits of this backpack, as it tells and keeps them. */
#define CHANNELS 0x0Fu
#define WAVEFORMS (1u << SYMMETRIC_BIPHASIC)
#define MAX_FREQUENCY_HZ 150u
#define MAX_PULSE_WIDTH_US 10000u
#define MAX_AMPLITUDE_MV 4000u
#define MAX_DURATION_MS 1000u

enum mode { CRW = 0, S = 1 };
enum cause { NATURAL = 0, COMMAND = 1 };
enum action { START = 1, STOP = 2, FOLLOW_WALLS = 5 };
enum configuration_result { CONFIGURED = 0, NOT_SUPPORTED = 2 };
enum verdict { FIT, UNFIT, BEYOND_LIMITS };

static bool is_due(uint32_t at_ms, uint32_t now_ms)
{
    return now_ms - at_ms < 0x80000000u;
}

void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms)
{
    struct bb_hello hello = {{0, BB_BENCH_EUI64_1, 0, 0, 0, 0, 0, 0}, FIRMWARE, 0, CAN_BE_STIMULATED | TAKES_CONFIGURE, BB_PROTOCOL_VERSION};
    hello.eui64[0] = node;
    *backpack = (struct bb_bench_backpack){0};
    bb_backpack_start(&backpack->messages, node, FIRST_BOOT, &hello, now_ms);
    backpack->report_period_ms = BB_BENCH_BATCH_MS;
    backpack->mode_since_ms = now_ms;
    backpack->train_until_ms = now_ms;
    backpack->next_batch_ms = now_ms;
    backpack->owes_status = true;
}

void bb_bench_backpack_wake(struct bb_bench_backpack *backpack)
{
    struct bb_backpack *messages = &backpack->messages;
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        struct bb_backpack_slot *slot = &messages->slots[i];
        /* A message may have been written, and its number neither noted nor counted. */
        slot->sequence = (uint16_t)((unsigned)slot->payload[SEQUENCE_AT] | (unsigned)slot->payload[SEQUENCE_AT + 1u] << 8);
        if (slot->length != 0u && slot->sequence == messages->next_sequence) {
            messages->next_sequence++;
        }
    }
}

/* --- what it has to say ------------------------------------------------------------------------------------------------------ */

static bool report(struct bb_bench_backpack *backpack, uint8_t type, struct bb_uplink *message, uint32_t now_ms)
{
    message->header.type = type;
    return bb_backpack_report(&backpack->messages, message, now_ms);
}

static void report_limits(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_limits *limits = &message.body.limits;
    limits->channels = CHANNELS;
    limits->waveforms = WAVEFORMS;
    limits->max_frequency_hz = MAX_FREQUENCY_HZ;
    limits->max_pulse_width_us = MAX_PULSE_WIDTH_US;
    limits->max_amplitude_mv = MAX_AMPLITUDE_MV;
    limits->max_duration_ms = MAX_DURATION_MS;
    limits->max_on_ms_per_minute = 60000u;
    limits->battery_mv = BATTERY_MV;
    limits->battery_empty_mv = BATTERY_EMPTY_MV;
    limits->encounter_capacity = BB_BENCH_REPORTS;
    (void)report(backpack, BB_TYPE_LIMITS, &message, now_ms); /* owed until there is room */
}

static bool report_status(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_status *status = &message.body.status;
    status->mode = backpack->mode;
    status->cause = backpack->cause;
    status->mode_since_ms = backpack->mode_since_ms;
    status->battery_mv = BATTERY_MV;
    status->buffered = (uint16_t)(BB_BENCH_REPORTS - backpack->next_report);
    return report(backpack, BB_TYPE_STATUS, &message, now_ms);
}

static bool report_configuration(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_configuration_report *told = &message.body.configuration_report;
    told->token = backpack->configuration_token;
    told->result = backpack->configuration_result;
    told->rssi_enter_dbm = INT8_MIN; /* it has no beacons: section 5.11 */
    told->rssi_exit_dbm = INT8_MIN;
    told->report_period_ms = backpack->report_period_ms;
    return report(backpack, BB_TYPE_CONFIGURATION_REPORT, &message, now_ms);
}

static void report_encounters(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_encounter_batch *batch = &message.body.encounter_batch;
    uint16_t index = backpack->next_report;
    if (index >= BB_BENCH_REPORTS || !is_due(backpack->next_batch_ms, now_ms)) {
        return;
    }
    while (batch->n_entries < ENTRIES_PER_BATCH && index < BB_BENCH_REPORTS) {
        bb_bench_report((uint8_t)backpack->messages.node, index, &batch->entries[batch->n_entries]);
        batch->n_entries++;
        index++;
    }
    if (report(backpack, BB_TYPE_ENCOUNTER_BATCH, &message, now_ms)) {
        backpack->next_report = index; /* cut off before this, the batch is said twice: nobody minds */
        backpack->next_batch_ms = now_ms + backpack->report_period_ms;
    }
}

/* --- stimulation (WIRE_FORMAT.md section 6.8) -------------------------------------------------------------------------------- */

static void change_mode(struct bb_bench_backpack *backpack, uint8_t mode, uint8_t cause, uint32_t now_ms)
{
    if (mode != backpack->mode || cause != backpack->cause) {
        backpack->mode = mode;
        backpack->cause = cause;
        backpack->mode_since_ms = now_ms;
        backpack->owes_status = true;
    }
}

static enum verdict judge(const struct bb_stimulate *command)
{
    /* Of the waveforms it knows the symmetric one alone, so a monophasic pulse of any length is beyond its limits. */
    uint32_t most = command->waveform == 2u ? 2u * MOST_BIPHASIC : MOST_BIPHASIC;
    uint32_t product = (uint32_t)command->pulse_width_us * command->frequency_hz;
    if (command->action == FOLLOW_WALLS) {
        return UNFIT; /* no capability of this backpack */
    }
    if (command->duration_ms == 0u) {
        return command->action <= STOP ? FIT : UNFIT; /* a start or stop without a train */
    }
    if (product == 0u || product > most) {
        return UNFIT;
    }
    if ((command->channel != OWN_CHANNEL && (command->channel > 7u || (CHANNELS >> command->channel & 1u) == 0u))
        || (WAVEFORMS >> command->waveform & 1u) == 0u || command->frequency_hz > MAX_FREQUENCY_HZ
        || command->pulse_width_us > MAX_PULSE_WIDTH_US || command->amplitude_mv > MAX_AMPLITUDE_MV
        || command->duration_ms > MAX_DURATION_MS) {
        return BEYOND_LIMITS;
    }
    return FIT;
}

static void answer(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint8_t result, uint32_t now_ms)
{
    bb_backpack_answer(&backpack->messages, command->command, result, now_ms, backpack->mode, now_ms);
}

/* Obey: give the train, if it is fit, and do with the insect what the action says. A turn leaves one that is held still as it is. */
static void execute(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    backpack->train_until_ms = now_ms + (judge(command) == FIT ? command->duration_ms : 0u);
    if (command->action <= STOP) {
        backpack->is_held_still = command->action == STOP;
        change_mode(backpack, command->action == STOP ? S : CRW, COMMAND, now_ms);
    } else if (backpack->mode == CRW) {
        change_mode(backpack, CRW, COMMAND, now_ms);
    }
    if (command->action <= STOP || !backpack->is_held_still) {
        backpack->is_holding = command->hold_ms != 0u;
        backpack->hold_until_ms = now_ms + command->hold_ms;
    }
    answer(backpack, command, BB_STIMULATION_DONE, now_ms);
}

static void end_hold(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    if (backpack->is_holding && is_due(backpack->hold_until_ms, now_ms)) {
        backpack->is_holding = false;
        if (backpack->is_held_still) {
            change_mode(backpack, CRW, NATURAL, now_ms);
        } else { /* whoever controlled the motion has gone */
            change_mode(backpack, S, COMMAND, now_ms);
            if (!is_due(backpack->train_until_ms, now_ms)) {
                backpack->train_until_ms = now_ms;
            }
        }
        backpack->is_held_still = !backpack->is_held_still;
    }
}

/* Oldest first: execute what waited for the end of a train, and refuse what waited for longer than it might. */
static void serve_queue(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    uint8_t n_kept = 0;
    uint8_t i;
    for (i = 0; i < backpack->n_queued; i++) {
        const struct bb_bench_waiting *one = &backpack->queue[i];
        if (now_ms - one->received_ms > one->command.ttl_ms) {
            answer(backpack, &one->command, BB_STIMULATION_EXPIRED, now_ms);
        } else if (is_due(backpack->train_until_ms, now_ms)) {
            execute(backpack, &one->command, now_ms);
        } else {
            backpack->queue[n_kept++] = *one;
        }
    }
    backpack->n_queued = n_kept;
}

static void obey(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    enum verdict verdict = judge(command);
    uint8_t i;
    if (command->action == STOP) {
        execute(backpack, command, now_ms); /* and is answered first, where there is little room */
        for (i = 0; i < backpack->n_queued; i++) {
            answer(backpack, &backpack->queue[i].command, BB_STIMULATION_EXPIRED, now_ms);
        }
        backpack->n_queued = 0;
    } else if (verdict == UNFIT) {
        answer(backpack, command, BB_STIMULATION_BAD_PARAMETER, now_ms);
    } else if (verdict == BEYOND_LIMITS || backpack->n_queued == BB_BENCH_QUEUE) {
        answer(backpack, command, BB_STIMULATION_REFUSED_LIMIT, now_ms);
    } else {
        backpack->queue[backpack->n_queued].command = *command;
        backpack->queue[backpack->n_queued].received_ms = now_ms;
        backpack->n_queued++;
        serve_queue(backpack, now_ms);
    }
}

/* --- on the air -------------------------------------------------------------------------------------------------------------- */

uint8_t bb_bench_backpack_speak(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD])
{
    uint32_t draw = bb_bench_mix((uint32_t)backpack->messages.node << 16 ^ backpack->n_draws);
    uint8_t length;
    end_hold(backpack, now_ms);
    serve_queue(backpack, now_ms);
    if (bb_backpack_owes_limits(&backpack->messages)) {
        report_limits(backpack, now_ms);
    }
    backpack->owes_status = backpack->owes_status && !report_status(backpack, now_ms);
    backpack->owes_configuration = backpack->owes_configuration && !report_configuration(backpack, now_ms);
    report_encounters(backpack, now_ms);
    length = bb_backpack_next(&backpack->messages, now_ms, (uint16_t)(draw >> 16), payload);
    if (length != 0u) {
        backpack->n_draws++;
    }
    return length;
}

/* All of it or nothing; of what may be wished, a pack without beacons has the report period alone (WIRE_FORMAT.md section 6.6). */
static void configure(struct bb_bench_backpack *backpack, const struct bb_configure *wish)
{
    bool is_of_beacons = wish->beacon_period_ms != 0u || wish->gap_tolerance_ms != 0u || wish->rssi_enter_dbm != INT8_MIN
        || wish->rssi_exit_dbm != INT8_MIN;
    backpack->configuration_result = is_of_beacons ? NOT_SUPPORTED : CONFIGURED;
    if (!is_of_beacons && wish->report_period_ms != 0u) {
        backpack->report_period_ms = wish->report_period_ms;
    }
}

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, bool is_broadcast, uint32_t now_ms)
{
    struct bb_downlink message;
    uint16_t chance = (uint16_t)bb_bench_mix((uint32_t)backpack->messages.node << 16 ^ backpack->n_draws++);
    if (!bb_backpack_receive(&backpack->messages, payload, length, is_broadcast, now_ms, chance, &message)) {
        return;
    }
    if (message.header.type == BB_TYPE_STIMULATE) {
        obey(backpack, &message.body.stimulate, now_ms);
        return;
    }
    backpack->configuration_result = CONFIGURED;
    if (message.header.type == BB_TYPE_CONFIGURE) {
        configure(backpack, &message.body.configure);
        backpack->configuration_token = message.body.configure.token;
    } else {
        backpack->configuration_token = message.body.configuration_request.token;
    }
    backpack->owes_configuration = !report_configuration(backpack, now_ms);
}
