/* The message side of a backpack under any base station, clock and owner.
 *
 * Laws: what goes on the air is a message of this backpack, with the time of sending; numbers are given in order and span at most 32; a
 * number stands for one message for good; a command is the owner's to obey once; no command has two answers under way; reports leave two slots
 * and two numbers to answers; in the end all is acknowledged and it falls silent.
 */
#include "biobot_backpack.h"
#include "biobot_crc.h"
#include "fuzz_input.h"

#include <string.h>

#define NODE 7u
#define BOOT 3u
#define MOST_AT_ONCE (BB_BACKPACK_SLOTS + 2u) /* every slot once, a Hello and a time sync */

static struct bb_backpack *backpack;
static uint32_t now_ms;
static uint32_t obeyed[BB_BACKPACK_COMMANDS]; /* the newest commands that were the owner's to obey */
static uint16_t n_obeyed;
static uint16_t said[0x10000]; /* by number: CRC of the body that it stood for, with the highest bit of `is_said` beside */
static uint8_t is_said[0x10000];
static uint16_t said_at[1024];
static uint16_t n_said;

static bool is_answer(uint8_t type)
{
    return type == BB_TYPE_HELLO || type == BB_TYPE_CONFIGURATION_REPORT || type == BB_TYPE_STIMULATE_REPLY;
}

/* After a report was taken, two slots and two numbers are left at least; no two outstanding answers are of one command. */
static void check_slots(bool was_reported)
{
    uint8_t n_free = 0;
    uint16_t furthest = 0;
    for (uint8_t i = 0; i < BB_BACKPACK_SLOTS; i++) {
        const struct bb_backpack_slot *one = &backpack->slots[i];
        uint16_t behind = (uint16_t)(backpack->next_sequence - one->sequence);
        if (one->length == 0) {
            n_free++;
            continue;
        }
        if (behind > furthest) furthest = behind;
        for (uint8_t k = 0; k < i; k++) {
            const struct bb_backpack_slot *other = &backpack->slots[k];
            LAW(other->length == 0 || one->payload[0] != BB_TYPE_STIMULATE_REPLY || other->payload[0] != BB_TYPE_STIMULATE_REPLY
                || memcmp(one->payload + 12, other->payload + 12, 4) != 0);
        }
    }
    if (was_reported) LAW(n_free >= 2 && furthest <= 31);
}

static void report(struct bb_uplink *message)
{
    /* The owner answers commands by bb_backpack_answer, and a Hello is not its own. */
    if (message->header.type == BB_TYPE_STIMULATE_REPLY || message->header.type == BB_TYPE_HELLO) return;
    if (bb_backpack_report(backpack, message, now_ms)) check_slots(!is_answer(message->header.type));
}

static void note(uint16_t sequence, uint16_t sum)
{
    if (!is_said[sequence]) {
        if (n_said == sizeof said_at / sizeof *said_at) return;
        said_at[n_said++] = sequence;
        is_said[sequence] = 1;
        said[sequence] = sum;
    }
    LAW(said[sequence] == sum);
}

static uint8_t speak(uint16_t chance)
{
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
    struct bb_uplink message;
    uint8_t length = bb_backpack_next(backpack, now_ms, chance, payload);
    if (length == 0) return 0;
    LAW(length <= BB_MAX_RADIO_PAYLOAD && bb_decode_uplink(payload, length, &message) == BB_OK);
    LAW(message.header.node == NODE && message.header.boot == BOOT && message.header.sent_ms == now_ms);
    if (message.header.type != BB_TYPE_TIME_SYNC_REPLY) {
        uint16_t behind = (uint16_t)(backpack->next_sequence - message.header.sequence);
        LAW(behind >= 1 && behind <= 33);
        memset(payload + 8, 0, 4); /* the time of sending alone may differ between copies */
        note(message.header.sequence, bb_crc16(payload, (uint8_t)(length - 2)));
    }
    return length;
}

static void hear(uint8_t *octets, uint8_t length)
{
    struct bb_downlink message;
    bool is_broadcast = length != 0 && (octets[length - 1] & 1) != 0;
    bool is_owners = bb_backpack_receive(backpack, octets, length, is_broadcast, now_ms, (uint16_t)(now_ms * 7919u), &message);
    check_slots(false);
    if (!is_owners) return;
    LAW(message.header.type == BB_TYPE_STIMULATE || message.header.type == BB_TYPE_CONFIGURE
        || message.header.type == BB_TYPE_CONFIGURATION_REQUEST);
    if (message.header.type != BB_TYPE_STIMULATE) return;
    LAW(!is_broadcast || message.body.stimulate.action == 2); /* of all, only a stop is asked by broadcast */
    for (uint16_t i = 0; i < BB_BACKPACK_COMMANDS && i < n_obeyed; i++) LAW(obeyed[i] != message.body.stimulate.command);
    obeyed[n_obeyed++ % BB_BACKPACK_COMMANDS] = message.body.stimulate.command;
}

/* A downlink message with a good checksum, its body as the input says. */
static void hear_message(struct input *input, uint8_t type, uint8_t most)
{
    uint8_t payload[BB_MAX_RADIO_PAYLOAD], length;
    uint8_t *body = take_block(input, most, &length);
    payload[0] = type;
    payload[1] = BB_PROTOCOL_VERSION;
    payload[2] = payload[3] = 0;
    memcpy(payload + 4, body, length);
    uint16_t crc = bb_crc16(payload, (uint8_t)(length + 4));
    payload[length + 4] = (uint8_t)(crc >> 8);
    payload[length + 5] = (uint8_t)(crc & 0xFF);
    hear(payload, (uint8_t)(length + 6));
    free(body);
}

static void hear_acknowledge(uint16_t next, uint32_t bitmap)
{
    struct bb_downlink message = {{BB_TYPE_ACKNOWLEDGE, BB_PROTOCOL_VERSION, 0}, {.acknowledge = {BOOT, next, bitmap}}};
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
    hear(payload, bb_encode_downlink(&message, payload, sizeof payload));
}

/* All but the oldest number is on disk: so the span grows, while slots are free. */
static void hear_all_but_the_oldest(void)
{
    uint16_t furthest = 0;
    for (uint8_t i = 0; i < BB_BACKPACK_SLOTS; i++) {
        uint16_t behind = (uint16_t)(backpack->next_sequence - backpack->slots[i].sequence);
        if (backpack->slots[i].length != 0 && behind > furthest) furthest = behind;
    }
    hear_acknowledge((uint16_t)(backpack->next_sequence - furthest), 0xFFFFFFFFu);
}

static void act(struct input *input)
{
    uint8_t action = take_u8(input), length;
    uint16_t number;
    uint32_t command;
    uint8_t *block;
    struct bb_uplink message;
    uint32_t at_ms;
    switch (action % 8) {
    case 0:
        block = take_block(input, (uint8_t)(action >> 2), &length);
        hear(block, length);
        free(block);
        break;
    case 1:
        hear_message(input, (uint8_t)(0x81 + (action >> 3) % 7), 40);
        break;
    case 2: /* near the numbers that are in use */
        number = (uint16_t)(backpack->next_sequence - (action >> 3));
        if (action & 0x80) {
            hear_all_but_the_oldest();
        } else {
            hear_acknowledge(number, (uint32_t)take_u16(input) << (action & 16));
        }
        break;
    case 3: /* decoded from the input, so that it is a message of the format */
        block = take_block(input, BB_MAX_RADIO_PAYLOAD, &length);
        if (bb_decode_uplink(block, length, &message) == BB_OK) report(&message);
        free(block);
        break;
    case 4:
        memset(&message, 0, sizeof message);
        message.header.type = BB_TYPE_STATUS;
        message.body.status.mode_since_ms = take_u8(input);
        report(&message);
        break;
    case 5:
        for (uint8_t n = 0; speak((uint16_t)(action << 8)) != 0;) LAW(++n <= MOST_AT_ONCE);
        break;
    case 6:
        now_ms += action & 0x80 ? (uint32_t)take_u16(input) << 8 : take_u8(input);
        if (action & 0x40) bb_backpack_hurry(backpack, now_ms);
        break;
    default:
        command = n_obeyed ? obeyed[(action >> 3) % (n_obeyed < BB_BACKPACK_COMMANDS ? n_obeyed : BB_BACKPACK_COMMANDS)] : action;
        bb_backpack_answer(backpack, command, (uint8_t)((action >> 3) % 5), now_ms, action >> 7, now_ms);
        check_slots(false);
        break;
    }
    (void)bb_backpack_next_deadline(backpack, now_ms, &at_ms);
}

static void check_that_it_ends(void)
{
    uint32_t at_ms;
    for (unsigned round = 0; round < 3 + BB_BACKPACK_COMMANDS / BB_BACKPACK_SLOTS; round++) {
        now_ms += 1000; /* an answer to a broadcast may wait as long */
        for (uint8_t n = 0; speak(0) != 0;) LAW(++n <= MOST_AT_ONCE);
        hear_acknowledge(backpack->next_sequence, 0);
    }
    now_ms += 100000;
    LAW(speak(0) == 0 && !bb_backpack_next_deadline(backpack, now_ms, &at_ms));
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const struct bb_hello hello = {{1, 2, 3, 4, 5, 6, 7, 8}, 1, 0, 1, BB_PROTOCOL_VERSION};
    struct input input = {data, size};
    backpack = malloc(sizeof *backpack);
    LAW(backpack != NULL);
    memset(backpack, 0xA5, sizeof *backpack);
    now_ms = 0xFFFFF000u;
    n_obeyed = 0;
    while (n_said) is_said[said_at[--n_said]] = 0;
    bb_backpack_start(backpack, NODE, BOOT, &hello, now_ms);
    while (input.left) act(&input);
    check_that_it_ends();
    free(backpack);
    return 0;
}
