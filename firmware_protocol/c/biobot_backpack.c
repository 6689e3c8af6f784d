#include "biobot_backpack.h"

#include "biobot_crc.h"

#define WINDOW 32u /* how far the newest number may be ahead of the oldest outstanding one (WIRE_FORMAT.md section 5.1) */
#define FIRST_WAIT_MS 1000u
#define MAX_WAIT_MS 30000u
#define MAX_DOUBLINGS 5u /* 1 s << 5 is beyond 30 s */
#define MAX_SPREAD_MS 1000u /* a broadcast is answered within this */
#define COMMAND_PENDING 0xFFu
#define ACTION_STOP 2u /* of a Stimulate (section 6.5) */
#define SENT_AT 8u     /* of sent_ms in a payload (WIRE_FORMAT.md section 5.1) */
#define COMMAND_AT 12u /* of command in a StimulateReply (section 5.7) */

static bool is_due(uint32_t at_ms, uint32_t now_ms)
{
    return now_ms - at_ms < 0x80000000u;
}

/* How far behind next_sequence the oldest outstanding number is; 0: nothing is outstanding. */
static uint16_t span(const struct bb_backpack *backpack)
{
    uint16_t most = 0;
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        uint16_t behind = (uint16_t)(backpack->next_sequence - backpack->slots[i].sequence);
        if (backpack->slots[i].length != 0u && behind > most) {
            most = behind;
        }
    }
    return most;
}

static void put_time_and_crc(uint8_t *payload, uint8_t length, uint32_t now_ms)
{
    uint8_t i;
    uint16_t crc;
    for (i = 0; i < 4u; i++) {
        payload[SENT_AT + i] = (uint8_t)(now_ms & 0xFFu);
        now_ms >>= 8;
    }
    crc = bb_crc16(payload, (uint8_t)(length - 2u));
    payload[length - 2u] = (uint8_t)(crc >> 8);
    payload[length - 1u] = (uint8_t)(crc & 0xFFu);
}

/* How many slots, and how many numbers of the window, a message leaves to others: the last one is for what became of a command, the one
 * before it for other answers (WIRE_FORMAT.md section 5.1). */
static uint8_t reserve_of(uint8_t type)
{
    if (type == BB_TYPE_STIMULATE_REPLY) {
        return 0;
    }
    return type == BB_TYPE_HELLO || type == BB_TYPE_CONFIGURATION_REPORT ? 1 : 2;
}

/* The slot that a message of this type goes to; BB_BACKPACK_SLOTS: none, because slots or numbers are used up. */
static uint8_t find_slot(const struct bb_backpack *backpack, uint8_t type)
{
    uint8_t found = BB_BACKPACK_SLOTS;
    uint8_t reserve = reserve_of(type);
    uint8_t n_free = 0;
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        if (backpack->slots[i].length == 0u) {
            found = i;
            n_free++;
        }
    }
    return n_free > reserve && span(backpack) <= WINDOW - reserve ? found : (uint8_t)BB_BACKPACK_SLOTS;
}

/* When an answer to the last request goes: it may be waiting for its random instant. */
static uint32_t answer_at(const struct bb_backpack *backpack, uint32_t now_ms)
{
    return backpack->answer_at_ms - now_ms <= MAX_SPREAD_MS ? backpack->answer_at_ms : now_ms;
}

/* Number a message and keep it; it is sent from due_ms on. */
static bool keep(struct bb_backpack *backpack, struct bb_uplink *message, uint32_t due_ms)
{
    uint8_t found = find_slot(backpack, message->header.type);
    struct bb_backpack_slot *free_slot;
    if (found == BB_BACKPACK_SLOTS) {
        return false;
    }
    free_slot = &backpack->slots[found];
    message->header.version = BB_PROTOCOL_VERSION;
    message->header.node = backpack->node;
    message->header.boot = backpack->boot;
    message->header.sequence = backpack->next_sequence;
    message->header.sent_ms = due_ms;
    free_slot->length = bb_encode_uplink(message, free_slot->payload, BB_MAX_RADIO_PAYLOAD);
    if (free_slot->length == 0u) {
        return false;
    }
    free_slot->sequence = backpack->next_sequence;
    free_slot->n_sent = 0;
    free_slot->due_ms = due_ms;
    backpack->next_sequence++;
    return true;
}

static bool is_outstanding(const struct bb_backpack *backpack, uint8_t type)
{
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        const struct bb_backpack_slot *slot = &backpack->slots[i];
        if (slot->length != 0u && slot->payload[0] == type && (type != BB_TYPE_HELLO || slot->sequence == backpack->hello_sequence)) {
            return true;
        }
    }
    return false;
}

/* Whatever waits for a repetition goes at this instant, if it would not go sooner. */
static void bring_forward(struct bb_backpack *backpack, uint32_t at_ms)
{
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        if (!is_due(backpack->slots[i].due_ms, at_ms)) {
            backpack->slots[i].due_ms = at_ms;
        }
    }
}

static void keep_hello(struct bb_backpack *backpack, uint32_t now_ms)
{
    struct bb_uplink message;
    message.header.type = BB_TYPE_HELLO;
    message.body.hello = backpack->hello;
    if (keep(backpack, &message, answer_at(backpack, now_ms))) {
        backpack->hello_sequence = message.header.sequence;
        backpack->is_hello_told = true;
        backpack->is_limits_owed = true;
        backpack->is_hello_owed = false;
    } else {
        backpack->is_hello_owed = true;
    }
}

/* A Hello is asked for. One that is under way is sent sooner, with all the rest, and not said twice. */
static void say_hello(struct bb_backpack *backpack, uint32_t now_ms)
{
    bring_forward(backpack, answer_at(backpack, now_ms));
    if (!backpack->is_hello_told || !is_outstanding(backpack, BB_TYPE_HELLO)) {
        keep_hello(backpack, now_ms);
    } else if (!is_outstanding(backpack, BB_TYPE_LIMITS)) {
        backpack->is_limits_owed = true;
    }
}

static uint32_t wait_ms(uint8_t n_sent, uint16_t chance)
{
    uint32_t wait = n_sent < MAX_DOUBLINGS ? (uint32_t)FIRST_WAIT_MS << n_sent : MAX_WAIT_MS;
    return wait - wait / 4u + (wait / 2u * chance >> 16);
}

void bb_backpack_start(struct bb_backpack *backpack, uint16_t node, uint16_t boot, const struct bb_hello *hello, uint32_t now_ms)
{
    uint8_t i;
    backpack->hello = *hello;
    backpack->node = node;
    backpack->boot = boot;
    backpack->next_sequence = 0;
    backpack->n_ignored = 0;
    backpack->n_commands = 0;
    backpack->next_command = 0;
    backpack->is_sync_owed = false;
    backpack->is_spread = false;
    backpack->is_hello_told = false;
    backpack->answer_at_ms = now_ms;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        backpack->slots[i].length = 0;
    }
    keep_hello(backpack, now_ms);
}

void bb_backpack_describe(struct bb_backpack *backpack, const struct bb_hello *hello, uint32_t now_ms)
{
    backpack->hello = *hello;
    backpack->is_hello_told = false;
    keep_hello(backpack, now_ms);
}

bool bb_backpack_report(struct bb_backpack *backpack, struct bb_uplink *message, uint32_t now_ms)
{
    uint8_t type = message->header.type;
    bool is_answer = type == BB_TYPE_LIMITS || type == BB_TYPE_CONFIGURATION_REPORT;
    if (!keep(backpack, message, is_answer ? answer_at(backpack, now_ms) : now_ms)) {
        return false;
    }
    if (type == BB_TYPE_LIMITS) {
        backpack->is_limits_owed = false;
    }
    return true;
}

bool bb_backpack_owes_limits(const struct bb_backpack *backpack)
{
    return backpack->is_limits_owed;
}

/* The time sync reply is not kept and not numbered; it goes first, because its time of sending is what it is for. */
static uint8_t write_sync(struct bb_backpack *backpack, uint32_t now_ms, uint8_t *payload)
{
    struct bb_uplink message;
    message.header.type = BB_TYPE_TIME_SYNC_REPLY;
    message.header.version = BB_PROTOCOL_VERSION;
    message.header.node = backpack->node;
    message.header.boot = backpack->boot;
    message.header.sequence = 0;
    message.header.sent_ms = now_ms;
    message.body.time_sync_reply.token = backpack->sync_token;
    message.body.time_sync_reply.received_ms = backpack->sync_received_ms;
    backpack->is_sync_owed = false;
    return bb_encode_uplink(&message, payload, BB_MAX_RADIO_PAYLOAD);
}

static struct bb_backpack_command *find_command(struct bb_backpack *backpack, uint32_t command)
{
    uint8_t i;
    for (i = 0; i < backpack->n_commands; i++) {
        if (backpack->commands[i].command == command) {
            return &backpack->commands[i];
        }
    }
    return 0;
}

/* Whether an answer to the command is under way; it goes at this instant, if it would not go sooner. */
static bool repeat_answer(struct bb_backpack *backpack, uint32_t command, uint32_t at_ms)
{
    uint8_t i;
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        struct bb_backpack_slot *slot = &backpack->slots[i];
        const uint8_t *at = slot->payload + COMMAND_AT;
        if (slot->length != 0u && slot->payload[0] == BB_TYPE_STIMULATE_REPLY && at[0] == (uint8_t)(command & 0xFFu)
            && at[1] == (uint8_t)(command >> 8 & 0xFFu) && at[2] == (uint8_t)(command >> 16 & 0xFFu)
            && at[3] == (uint8_t)(command >> 24)) {
            if (!is_due(slot->due_ms, at_ms)) {
                slot->due_ms = at_ms;
            }
            return true;
        }
    }
    return false;
}

/* When an answer to a command goes: one to a broadcast may be waiting for its random instant. */
static uint32_t command_answer_at(const struct bb_backpack *backpack, uint32_t command, uint32_t now_ms)
{
    bool is_waiting = backpack->is_spread && command == backpack->spread_command && backpack->spread_until_ms - now_ms <= MAX_SPREAD_MS;
    return is_waiting ? backpack->spread_until_ms : now_ms;
}

/* Number and keep the answer to a command; one that is under way is not said twice. */
static bool keep_answer(struct bb_backpack *backpack, const struct bb_backpack_command *command, uint8_t result, uint32_t now_ms)
{
    struct bb_uplink message;
    uint32_t at_ms = command_answer_at(backpack, command->command, now_ms);
    if (repeat_answer(backpack, command->command, at_ms)) {
        return true;
    }
    message.header.type = BB_TYPE_STIMULATE_REPLY;
    message.body.stimulate_reply.command = command->command;
    message.body.stimulate_reply.result = result;
    message.body.stimulate_reply.executed_ms = command->executed_ms;
    message.body.stimulate_reply.mode = command->mode;
    return keep(backpack, &message, at_ms);
}

static void keep_what_is_owed(struct bb_backpack *backpack, uint32_t now_ms)
{
    uint8_t i;
    if (backpack->is_hello_owed) {
        keep_hello(backpack, now_ms);
    }
    for (i = 0; i < backpack->n_commands; i++) {
        struct bb_backpack_command *command = &backpack->commands[i];
        if (command->is_owed && keep_answer(backpack, command, command->result, now_ms)) {
            command->is_owed = false;
        }
    }
}

uint8_t bb_backpack_next(struct bb_backpack *backpack, uint32_t now_ms, uint16_t chance, uint8_t payload[BB_MAX_RADIO_PAYLOAD])
{
    struct bb_backpack_slot *oldest = 0;
    uint16_t furthest = 0;
    uint8_t i;
    if (backpack->is_sync_owed) {
        return write_sync(backpack, now_ms, payload);
    }
    keep_what_is_owed(backpack, now_ms);
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        struct bb_backpack_slot *slot = &backpack->slots[i];
        uint16_t behind = (uint16_t)(backpack->next_sequence - slot->sequence);
        if (slot->length != 0u && is_due(slot->due_ms, now_ms) && behind > furthest) {
            oldest = slot;
            furthest = behind;
        }
    }
    if (oldest == 0) {
        return 0;
    }
    put_time_and_crc(oldest->payload, oldest->length, now_ms);
    for (i = 0; i < oldest->length; i++) {
        payload[i] = oldest->payload[i];
    }
    oldest->due_ms = now_ms + wait_ms(oldest->n_sent, chance);
    if (oldest->n_sent < MAX_DOUBLINGS) {
        oldest->n_sent++;
    }
    return oldest->length;
}

static bool is_covered(uint16_t sequence, const struct bb_acknowledge *acknowledge)
{
    uint16_t ahead = (uint16_t)(sequence - acknowledge->next_sequence);
    if (ahead >= 0x8000u) {
        return true;
    }
    return ahead >= 1u && ahead <= 32u && (acknowledge->bitmap >> (ahead - 1u) & 1u) != 0u;
}

static void acknowledged(struct bb_backpack *backpack, const struct bb_acknowledge *acknowledge, uint32_t now_ms, uint16_t chance)
{
    uint32_t soon_ms = now_ms + wait_ms(0, chance);
    uint16_t ahead = (uint16_t)(acknowledge->next_sequence - backpack->next_sequence);
    bool is_progress = false;
    uint8_t i;
    if (acknowledge->boot != backpack->boot || (ahead != 0u && ahead < 0x8000u)) {
        backpack->n_ignored++; /* of another boot, or of numbers that were never given */
        return;
    }
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        if (backpack->slots[i].length != 0u && is_covered(backpack->slots[i].sequence, acknowledge)) {
            backpack->slots[i].length = 0;
            is_progress = true;
        }
    }
    for (i = 0; is_progress && i < BB_BACKPACK_SLOTS; i++) {
        /* The base station hears us: what waits for a distant repetition is brought forward. */
        struct bb_backpack_slot *slot = &backpack->slots[i];
        if (slot->n_sent > 1u && !is_due(slot->due_ms, now_ms + FIRST_WAIT_MS)) {
            slot->due_ms = soon_ms;
            slot->n_sent = 1;
        }
    }
}

/* True: it is new, and the owner's to obey. A known one is answered again; while its answer is pending, owed or under way, that will come. */
static bool take_command(struct bb_backpack *backpack, uint32_t number, uint32_t now_ms)
{
    struct bb_backpack_command *known = find_command(backpack, number);
    if (known != 0) {
        if (known->result != COMMAND_PENDING && !known->is_owed) {
            uint8_t result = known->result == BB_STIMULATION_DONE ? (uint8_t)BB_STIMULATION_ALREADY_DONE : known->result;
            (void)keep_answer(backpack, known, result, now_ms); /* without room the base station asks again */
        }
        return false;
    }
    known = &backpack->commands[backpack->next_command];
    known->command = number;
    known->result = COMMAND_PENDING;
    known->mode = 0;
    known->is_owed = false;
    known->executed_ms = now_ms;
    backpack->next_command = (uint8_t)(backpack->next_command + 1u == BB_BACKPACK_COMMANDS ? 0u : backpack->next_command + 1u);
    if (backpack->n_commands < BB_BACKPACK_COMMANDS) {
        backpack->n_commands++;
    }
    return true;
}

bool bb_backpack_receive(struct bb_backpack *backpack, const uint8_t *payload, uint8_t length, bool is_broadcast, uint32_t now_ms,
                         uint16_t chance, struct bb_downlink *message)
{
    uint32_t spread_ms = is_broadcast ? (uint32_t)MAX_SPREAD_MS * chance >> 16 : 0u;
    if (bb_decode_downlink(payload, length, message) != BB_OK) {
        backpack->n_ignored++;
        return false;
    }
    switch (message->header.type) {
    case BB_TYPE_HELLO_REQUEST:
        backpack->answer_at_ms = now_ms + spread_ms;
        say_hello(backpack, now_ms);
        return false;
    case BB_TYPE_ACKNOWLEDGE:
        acknowledged(backpack, &message->body.acknowledge, now_ms, chance);
        return false;
    case BB_TYPE_TIME_SYNC_REQUEST:
        backpack->sync_token = message->body.time_sync_request.token;
        backpack->sync_received_ms = now_ms;
        backpack->is_sync_owed = true;
        return false;
    case BB_TYPE_STIMULATE:
        if (is_broadcast && message->body.stimulate.action != ACTION_STOP) {
            backpack->n_ignored++; /* a train for everybody is nobody's wish */
            return false;
        }
        if (is_broadcast || (backpack->is_spread && backpack->spread_command == message->body.stimulate.command)) {
            backpack->spread_command = message->body.stimulate.command;
            backpack->spread_until_ms = now_ms + spread_ms; /* asked again by itself alone, it is answered at once */
            backpack->is_spread = true;
        }
        return take_command(backpack, message->body.stimulate.command, now_ms);
    default: /* Configure, ConfigurationRequest */
        backpack->answer_at_ms = now_ms + spread_ms;
        return true;
    }
}

void bb_backpack_answer(struct bb_backpack *backpack, uint32_t command, uint8_t result, uint32_t executed_ms, uint8_t mode,
                        uint32_t now_ms)
{
    struct bb_backpack_command *known = find_command(backpack, command);
    if (known == 0 || known->result != COMMAND_PENDING) {
        return; /* 32 newer commands came: it is forgotten, and so is its answer; or it has been answered */
    }
    known->executed_ms = executed_ms;
    known->mode = mode;
    known->is_owed = true;
    known->result = result;
    known->is_owed = !keep_answer(backpack, known, result, now_ms);
}

void bb_backpack_hurry(struct bb_backpack *backpack, uint32_t now_ms)
{
    bring_forward(backpack, now_ms);
}

static bool is_answer_owed(const struct bb_backpack *backpack)
{
    uint8_t i;
    for (i = 0; i < backpack->n_commands; i++) {
        if (backpack->commands[i].is_owed) {
            return true;
        }
    }
    return false;
}

bool bb_backpack_next_deadline(const struct bb_backpack *backpack, uint32_t now_ms, uint32_t *at_ms)
{
    uint32_t least = 0x80000000u;
    uint8_t i;
    if (backpack->is_sync_owed || (backpack->is_hello_owed && find_slot(backpack, BB_TYPE_HELLO) != BB_BACKPACK_SLOTS)
        || (is_answer_owed(backpack) && find_slot(backpack, BB_TYPE_STIMULATE_REPLY) != BB_BACKPACK_SLOTS)) {
        least = 0;
    }
    for (i = 0; i < BB_BACKPACK_SLOTS; i++) {
        const struct bb_backpack_slot *slot = &backpack->slots[i];
        if (slot->length != 0u) {
            uint32_t in_ms = is_due(slot->due_ms, now_ms) ? 0u : slot->due_ms - now_ms;
            least = in_ms < least ? in_ms : least;
        }
    }
    *at_ms = now_ms + least;
    return least != 0x80000000u;
}
