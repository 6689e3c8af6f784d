#include "bb_bench_backpack.h"

#include "bb_bench_encounters.h"

#define FIRST_BOOT 1u
#define FIRMWARE 0x0100u
#define BATTERY_MV 3700u
#define BATTERY_EMPTY_MV 3000u
#define ENTRIES_PER_BATCH 4u
#define SEQUENCE_AT 6u /* in a payload's header (WIRE_FORMAT.md section 5.1) */
#define US_PER_S 1000000u

/* Capability bits (WIRE_FORMAT.md section 5.2). */
#define CAN_BE_STIMULATED 1u
#define TAKES_CONFIGURE 4u

/* Limits of this backpack, as it tells and keeps them. */
#define MAX_FREQUENCY_HZ 150u
#define MAX_PULSE_WIDTH_US 10000u
#define MAX_AMPLITUDE_MV 4000u
#define MAX_DURATION_MS 1000u

enum mode { CRW = 0, S = 1 };
enum cause { NATURAL = 0, COMMAND = 1 };
enum action { START = 1, STOP = 2 };
enum configuration_result { CONFIGURED = 0, BAD_CONFIGURATION = 1 };

static bool is_due(uint32_t at_ms, uint32_t now_ms)
{
    return now_ms - at_ms < 0x80000000u;
}

void bb_bench_backpack_boot(struct bb_bench_backpack *backpack, uint8_t node, uint32_t now_ms)
{
    static const struct bb_configure configuration = {0, 0, -85, -90, 0, BB_BENCH_BATCH_MS};
    struct bb_hello hello = {{0, BB_BENCH_EUI64_1, 0, 0, 0, 0, 0, 0}, FIRMWARE, 0, CAN_BE_STIMULATED | TAKES_CONFIGURE, BB_PROTOCOL_VERSION};
    hello.eui64[0] = node;
    *backpack = (struct bb_bench_backpack){0};
    bb_backpack_start(&backpack->messages, node, FIRST_BOOT, &hello);
    backpack->configuration = configuration;
    backpack->mode_since_ms = now_ms;
    backpack->next_batch_ms = now_ms;
    backpack->owes_limits = true;
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

static bool report_limits(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message = {0};
    struct bb_limits *limits = &message.body.limits;
    limits->channels = 0x0F;
    limits->waveforms = 0x01;
    limits->max_frequency_hz = MAX_FREQUENCY_HZ;
    limits->max_pulse_width_us = MAX_PULSE_WIDTH_US;
    limits->max_amplitude_mv = MAX_AMPLITUDE_MV;
    limits->max_duration_ms = MAX_DURATION_MS;
    limits->max_on_ms_per_minute = 60000u;
    limits->battery_mv = BATTERY_MV;
    limits->battery_empty_mv = BATTERY_EMPTY_MV;
    limits->encounter_capacity = BB_BENCH_REPORTS;
    return report(backpack, BB_TYPE_LIMITS, &message, now_ms);
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
    told->token = backpack->configuration.token;
    told->result = backpack->configuration_result;
    told->beacon_period_ms = backpack->configuration.beacon_period_ms;
    told->rssi_enter_dbm = backpack->configuration.rssi_enter_dbm;
    told->rssi_exit_dbm = backpack->configuration.rssi_exit_dbm;
    told->gap_tolerance_ms = backpack->configuration.gap_tolerance_ms;
    told->report_period_ms = backpack->configuration.report_period_ms;
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
        backpack->next_batch_ms = now_ms + backpack->configuration.report_period_ms;
    }
}

static bool answer(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    return bb_backpack_answer(&backpack->messages, backpack->answered_command, backpack->answer, backpack->answered_at_ms, backpack->mode,
                              now_ms);
}

static void end_hold(struct bb_bench_backpack *backpack, uint32_t now_ms)
{
    if (!backpack->is_holding || !is_due(backpack->hold_until_ms, now_ms)) {
        return;
    }
    backpack->is_holding = false;
    if (backpack->mode == S) {
        backpack->mode = CRW;
        backpack->cause = NATURAL;
        backpack->mode_since_ms = now_ms;
        backpack->owes_status = true;
    }
}

uint8_t bb_bench_backpack_speak(struct bb_bench_backpack *backpack, uint32_t now_ms, uint8_t payload[BB_MAX_RADIO_PAYLOAD])
{
    uint32_t draw = bb_bench_mix((uint32_t)backpack->messages.node << 16 ^ backpack->n_draws);
    uint8_t length;
    end_hold(backpack, now_ms);
    backpack->owes_answer = backpack->owes_answer && !answer(backpack, now_ms);
    backpack->owes_status = backpack->owes_status && !report_status(backpack, now_ms);
    backpack->owes_limits = backpack->owes_limits && !report_limits(backpack, now_ms);
    backpack->owes_configuration = backpack->owes_configuration && !report_configuration(backpack, now_ms);
    report_encounters(backpack, now_ms);
    length = bb_backpack_next(&backpack->messages, now_ms, (uint16_t)(draw >> 16), payload);
    if (length != 0u) {
        backpack->n_draws++;
    }
    return length;
}

/* --- what it hears ----------------------------------------------------------------------------------------------------------- */

static bool is_fit(const struct bb_stimulate *command)
{
    if (command->waveform != 0u) {
        return false;
    }
    if (command->duration_ms == 0u) {
        return command->action <= STOP; /* a start or stop without a train */
    }
    return command->frequency_hz != 0u && command->frequency_hz <= MAX_FREQUENCY_HZ && command->amplitude_mv <= MAX_AMPLITUDE_MV
        && command->duration_ms <= MAX_DURATION_MS && command->pulse_width_us != 0u && command->pulse_width_us <= MAX_PULSE_WIDTH_US
        && (uint32_t)command->pulse_width_us * command->frequency_hz <= US_PER_S;
}

static void execute(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    uint8_t mode = command->action == STOP ? S : command->action == START ? CRW : backpack->mode;
    if (mode != backpack->mode) {
        backpack->mode = mode;
        backpack->mode_since_ms = now_ms;
        backpack->owes_status = true;
    }
    backpack->cause = mode == S ? COMMAND : NATURAL;
    backpack->is_holding = command->hold_ms != 0u;
    backpack->hold_until_ms = now_ms + command->hold_ms;
}

static void obey(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    /* An unfit stop stops all the same: it is the train that is left out. */
    bool is_obeyed = command->action == STOP || is_fit(command);
    if (is_obeyed) {
        execute(backpack, command, now_ms);
    }
    backpack->answer = is_obeyed ? BB_STIMULATION_DONE : BB_STIMULATION_BAD_PARAMETER;
    backpack->answered_command = command->command;
    backpack->answered_at_ms = now_ms;
    backpack->owes_answer = true;
}

/* 0 of a period and -128 of a strength leave what there is (WIRE_FORMAT.md section 6.6). */
static void change_u16(uint16_t *value, uint16_t wish)
{
    if (wish != 0u) {
        *value = wish;
    }
}

static void change_dbm(int8_t *value, int8_t wish)
{
    if (wish != INT8_MIN) {
        *value = wish;
    }
}

static void configure(struct bb_bench_backpack *backpack, const struct bb_configure *wish)
{
    struct bb_configure changed = backpack->configuration;
    change_u16(&changed.beacon_period_ms, wish->beacon_period_ms);
    change_u16(&changed.gap_tolerance_ms, wish->gap_tolerance_ms);
    change_u16(&changed.report_period_ms, wish->report_period_ms);
    change_dbm(&changed.rssi_enter_dbm, wish->rssi_enter_dbm);
    change_dbm(&changed.rssi_exit_dbm, wish->rssi_exit_dbm);
    backpack->configuration_result = changed.rssi_exit_dbm <= changed.rssi_enter_dbm ? CONFIGURED : BAD_CONFIGURATION;
    if (backpack->configuration_result == CONFIGURED) {
        backpack->configuration = changed;
    }
}

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, uint32_t now_ms)
{
    struct bb_downlink message;
    bool is_ours = bb_backpack_receive(&backpack->messages, payload, length, now_ms, &message);
    if (backpack->messages.is_hello_owed) {
        backpack->owes_limits = true; /* they follow a Hello */
    }
    if (!is_ours) {
        return;
    }
    if (message.header.type == BB_TYPE_STIMULATE) {
        obey(backpack, &message.body.stimulate, now_ms);
        return;
    }
    backpack->configuration_result = CONFIGURED;
    if (message.header.type == BB_TYPE_CONFIGURE) {
        configure(backpack, &message.body.configure);
        backpack->configuration.token = message.body.configure.token;
    } else {
        backpack->configuration.token = message.body.configuration_request.token;
    }
    backpack->owes_configuration = true;
}
