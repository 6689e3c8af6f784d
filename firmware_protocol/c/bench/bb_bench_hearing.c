#include "bb_bench_backpack.h"

#define US_PER_S 1000000u

enum action { START = 1, STOP = 2 };
enum configuration_result { CONFIGURED = 0, BAD_CONFIGURATION = 1 };
enum result { DONE = 0, ALREADY_DONE = 1, BAD_PARAMETER = 4 };

static void forget(struct bb_bench_backpack *backpack, const struct bb_acknowledge *known)
{
    uint8_t i;
    if (known->boot != backpack->boot) {
        return;
    }
    for (i = 0; i < BB_BENCH_WINDOW; i++) {
        struct bb_bench_message *one = &backpack->messages[i];
        uint16_t ahead = (uint16_t)(one->sequence - known->next_sequence);
        if (one->is_kept && (ahead >= 0x8000u || (ahead >= 1u && ahead <= 32u && (known->bitmap >> (ahead - 1u) & 1u) != 0u))) {
            one->is_kept = 0;
        }
    }
}

static bool is_fit(const struct bb_stimulate *command)
{
    if (command->waveform != 0u) {
        return false;
    }
    if (command->duration_ms == 0u) {
        return command->action <= STOP; /* a start or stop without a train */
    }
    return command->frequency_hz != 0u && command->frequency_hz <= BB_BENCH_MAX_FREQUENCY_HZ && command->amplitude_mv <= BB_BENCH_MAX_AMPLITUDE_MV
        && command->duration_ms <= BB_BENCH_MAX_DURATION_MS && command->pulse_width_us != 0u && command->pulse_width_us <= BB_BENCH_MAX_PULSE_WIDTH_US
        && (uint32_t)command->pulse_width_us * command->frequency_hz <= US_PER_S;
}

static const struct bb_bench_command *find_command(const struct bb_bench_backpack *backpack, uint32_t command)
{
    uint8_t i;
    for (i = 0; i < BB_BENCH_REMEMBERED; i++) {
        if (backpack->commands[i].executed_ms != 0u && backpack->commands[i].command == command) {
            return &backpack->commands[i];
        }
    }
    return 0;
}

static void execute(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    uint8_t mode = command->action == STOP ? BB_BENCH_S : command->action == START ? BB_BENCH_CRW : backpack->mode;
    if (mode != backpack->mode) {
        backpack->mode = mode;
        backpack->mode_since_ms = now_ms;
        backpack->owes_status = true;
    }
    backpack->cause = mode == BB_BENCH_S ? BB_BENCH_COMMAND : BB_BENCH_NATURAL;
    backpack->is_holding = command->hold_ms != 0u;
    backpack->hold_until_ms = now_ms + command->hold_ms;
}

static void obey(struct bb_bench_backpack *backpack, const struct bb_stimulate *command, uint32_t now_ms)
{
    const struct bb_bench_command *known = find_command(backpack, command->command);
    struct bb_bench_command *to = &backpack->commands[backpack->next_command];
    uint8_t result;
    if (known != 0) {
        result = known->result == DONE ? ALREADY_DONE : known->result;
    } else {
        /* An unfit stop stops all the same: it is the train that is left out. */
        result = command->action == STOP || is_fit(command) ? DONE : BAD_PARAMETER;
        if (result == DONE) {
            execute(backpack, command, now_ms);
        }
        to->command = command->command;
        to->executed_ms = now_ms;
        to->result = result;
        backpack->next_command = (uint8_t)((backpack->next_command + 1u) % BB_BENCH_REMEMBERED);
        known = to;
    }
    backpack->reply.command = command->command;
    backpack->reply.result = result;
    backpack->reply.executed_ms = known->executed_ms;
    backpack->reply.mode = backpack->mode;
    backpack->owes_reply = true;
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
    backpack->configuration_token = wish->token;
    backpack->configuration_result = changed.rssi_exit_dbm <= changed.rssi_enter_dbm ? CONFIGURED : BAD_CONFIGURATION;
    if (backpack->configuration_result == CONFIGURED) {
        backpack->configuration = changed;
    }
    backpack->owes_configuration = true;
}

void bb_bench_backpack_hear(struct bb_bench_backpack *backpack, const uint8_t *payload, uint8_t length, uint32_t now_ms)
{
    struct bb_downlink message;
    if (bb_decode_downlink(payload, length, &message) != BB_OK) {
        return;
    }
    switch (message.header.type) {
    case BB_TYPE_HELLO_REQUEST:
        backpack->owes_hello = backpack->owes_limits = true;
        break;
    case BB_TYPE_ACKNOWLEDGE:
        forget(backpack, &message.body.acknowledge);
        break;
    case BB_TYPE_TIME_SYNC_REQUEST:
        backpack->asked_token = message.body.time_sync_request.token;
        backpack->asked_at_ms = now_ms;
        backpack->is_asked_time = true;
        break;
    case BB_TYPE_STIMULATE:
        obey(backpack, &message.body.stimulate, now_ms);
        break;
    case BB_TYPE_CONFIGURE:
        configure(backpack, &message.body.configure);
        break;
    default: /* a configuration request: the only type left */
        backpack->configuration_token = message.body.configuration_request.token;
        backpack->configuration_result = CONFIGURED;
        backpack->owes_configuration = true;
        break;
    }
}
