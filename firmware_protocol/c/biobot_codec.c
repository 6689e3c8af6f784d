#include "biobot_codec.h"

#include "biobot_crc.h"

#define CRC_SIZE 2u
#define ONGOING_BIT 0x80u
#define DURATION_BITS 0x3Fu

/* Octets on the wire of the operations BB_OP_END to BB_OP_U64. */
static const uint8_t sizes[] = {0, 1, 1, 2, 4, 8};

/* A place in a programme, a place in the bytes, and what went wrong so far. */
struct walk {
    const uint8_t *operation;
    uint8_t *bytes; /* only read while decoding */
    uint8_t left;   /* bytes behind it */
    uint8_t fault;
};

static const uint8_t *after_operation(const uint8_t *operation)
{
    uint8_t size = sizes[operation[0] & BB_OP_MASK];
    uint8_t length = 2;
    if ((operation[0] & BB_OP_LIMITED) != 0u) {
        length = (uint8_t)(length + 2u);
    }
    if ((operation[0] & BB_OP_DEFAULT) != 0u) {
        length = (uint8_t)(length + size);
    }
    return operation + length;
}

static bool is_outside(const uint8_t *operation, uint8_t value)
{
    return (operation[0] & BB_OP_LIMITED) != 0u && (value < operation[2] || value > operation[3]);
}

/* Integers go byte by byte: neither the order of bytes nor the alignment of the machine matters. A member of the struct is written as
 * what it is, through its own type. */
static void get_field(uint8_t operation, const uint8_t *bytes, uint8_t *member)
{
    uint8_t i;
    switch (operation & BB_OP_MASK) {
    case BB_OP_U16:
        *(uint16_t *)(void *)member = (uint16_t)((unsigned)bytes[0] | (unsigned)bytes[1] << 8);
        break;
    case BB_OP_U32:
        *(uint32_t *)(void *)member =
            (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
        break;
    default:
        for (i = 0; i < sizes[operation & BB_OP_MASK]; i++) {
            member[i] = bytes[i];
        }
        break;
    }
}

static void put_field(uint8_t operation, const uint8_t *member, uint8_t *bytes)
{
    uint32_t value;
    uint8_t i;
    switch (operation & BB_OP_MASK) {
    case BB_OP_U16:
        value = *(const uint16_t *)(const void *)member;
        break;
    case BB_OP_U32:
        value = *(const uint32_t *)(const void *)member;
        break;
    default:
        for (i = 0; i < sizes[operation & BB_OP_MASK]; i++) {
            bytes[i] = member[i];
        }
        return;
    }
    for (i = 0; i < sizes[operation & BB_OP_MASK]; i++) {
        bytes[i] = (uint8_t)(value & 0xFFu);
        value >>= 8;
    }
}

/* --- decoding ---------------------------------------------------------------------------------------------------------------- */

/* Take fields up to the next operation that is none. A wrong length is told before a wrong value. */
static void decode_fields(struct walk *walk, uint8_t *owner)
{
    uint8_t operation;
    while ((operation = walk->operation[0]) != BB_OP_END && (operation & BB_OP_MASK) <= BB_OP_U64) {
        const uint8_t *next = after_operation(walk->operation);
        uint8_t size = sizes[operation & BB_OP_MASK];
        uint8_t *member = owner + walk->operation[1];
        if (walk->left == 0u && (operation & BB_OP_DEFAULT) != 0u) {
            get_field(operation, next - size, member);
        } else if (walk->left < size) {
            walk->fault = BB_BAD_LENGTH;
            return;
        } else {
            get_field(operation, walk->bytes, member);
            if (is_outside(walk->operation, *member)) {
                walk->fault = BB_BAD_VALUE;
            }
            walk->bytes += size;
            walk->left = (uint8_t)(walk->left - size);
        }
        walk->operation = next;
    }
}

static void decode_entries(struct walk *walk, uint8_t *owner)
{
    const uint8_t *operation = walk->operation;
    uint8_t *entry = owner + operation[2];
    uint8_t rest = walk->left;
    uint8_t count = 0;
    while (rest >= operation[4]) { /* no division: a Cortex-M0+ and an 8051 call a library for it */
        rest = (uint8_t)(rest - operation[4]);
        count++;
    }
    if (rest != 0u || count < operation[5] || count > operation[6]) {
        walk->fault = BB_BAD_LENGTH;
        return;
    }
    owner[operation[1]] = count;
    while (count != 0u) {
        walk->operation = operation + 7;
        decode_fields(walk, entry);
        entry += operation[3];
        count--;
    }
}

static void decode_body(struct walk *walk, uint8_t *owner)
{
    decode_fields(walk, owner);
    if (walk->fault == BB_BAD_LENGTH) {
        return;
    }
    if (walk->operation[0] == BB_OP_ENTRIES) {
        decode_entries(walk, owner);
    } else if (walk->operation[0] == BB_OP_TAIL) {
        if (walk->left > walk->operation[3]) {
            walk->fault = BB_BAD_LENGTH;
            return;
        }
        *(const uint8_t **)(void *)(owner + walk->operation[1]) = walk->bytes;
        owner[walk->operation[2]] = walk->left;
    }
}

static const uint8_t *find_programme(const struct bb_layout *layouts, uint8_t n_layouts, uint8_t type)
{
    while (n_layouts != 0u) {
        if (layouts->type == type) {
            return layouts->programme;
        }
        layouts++;
        n_layouts--;
    }
    return 0;
}

#if BB_CODEC_MESSAGES
/* Check what every radio payload has, take its header, and find the programme of the rest. */
static void begin_payload(struct walk *walk, const uint8_t *payload, uint8_t length, const uint8_t *programme, uint8_t *header)
{
    walk->operation = programme;
    walk->bytes = (uint8_t *)payload;
    walk->fault = BB_OK;
    if (length > BB_MAX_RADIO_PAYLOAD) {
        walk->fault = BB_TOO_LONG;
        return;
    }
    if (length < CRC_SIZE || bb_crc16(payload, length) != 0u) {
        walk->fault = BB_BAD_CRC;
        return;
    }
    walk->left = (uint8_t)(length - CRC_SIZE);
    decode_fields(walk, header);
    if (walk->fault == BB_OK && header[1] != BB_PROTOCOL_VERSION) {
        walk->fault = BB_UNKNOWN_VERSION;
    }
}
#endif

static void end_payload(struct walk *walk, const struct bb_layout *layouts, uint8_t n_layouts, const uint8_t *type, uint8_t *body)
{
    if (walk->fault != BB_OK) {
        return;
    }
    walk->operation = find_programme(layouts, n_layouts, *type);
    if (walk->operation == 0) {
        walk->fault = BB_UNKNOWN_TYPE;
        return;
    }
    decode_body(walk, body);
}

#if BB_CODEC_MESSAGES
/* The one rule that binds two fields (WIRE_FORMAT.md section 5.5). */
static bool has_impossible_part(const struct bb_uplink *message)
{
    return message->header.type == BB_TYPE_NEIGHBOURS && message->body.neighbours.part >= message->body.neighbours.n_parts;
}

uint8_t bb_decode_uplink(const uint8_t *payload, uint8_t length, struct bb_uplink *message)
{
    struct walk walk;
    begin_payload(&walk, payload, length, bb_uplink_header_programme, (uint8_t *)&message->header);
    end_payload(&walk, bb_uplink_layouts, BB_N_UPLINK_LAYOUTS, &message->header.type, (uint8_t *)&message->body);
    if (walk.fault == BB_OK && has_impossible_part(message)) {
        walk.fault = BB_BAD_VALUE;
    }
    return walk.fault;
}

uint8_t bb_decode_downlink(const uint8_t *payload, uint8_t length, struct bb_downlink *message)
{
    struct walk walk;
    begin_payload(&walk, payload, length, bb_downlink_header_programme, (uint8_t *)&message->header);
    end_payload(&walk, bb_downlink_layouts, BB_N_DOWNLINK_LAYOUTS, &message->header.type, (uint8_t *)&message->body);
    return walk.fault;
}
#endif

uint8_t bb_decode_envelope(const uint8_t *body, uint8_t length, struct bb_envelope *envelope)
{
    struct walk walk;
    if (length == 0u) {
        return BB_UNKNOWN_TYPE;
    }
    envelope->type = body[0];
    walk.bytes = (uint8_t *)(body + 1);
    walk.left = (uint8_t)(length - 1u);
    walk.fault = BB_OK;
    end_payload(&walk, bb_envelope_layouts, BB_N_ENVELOPE_LAYOUTS, &envelope->type, (uint8_t *)&envelope->body);
    return walk.fault;
}

/* --- encoding ---------------------------------------------------------------------------------------------------------------- */

static void encode_fields(struct walk *walk, const uint8_t *owner)
{
    uint8_t operation;
    while ((operation = walk->operation[0]) != BB_OP_END && (operation & BB_OP_MASK) <= BB_OP_U64) {
        uint8_t size = sizes[operation & BB_OP_MASK];
        const uint8_t *member = owner + walk->operation[1];
        if (walk->left < size || is_outside(walk->operation, *member)) {
            walk->fault = BB_BAD_VALUE;
            return;
        }
        put_field(operation, member, walk->bytes);
        walk->bytes += size;
        walk->left = (uint8_t)(walk->left - size);
        walk->operation = after_operation(walk->operation);
    }
}

static void encode_body(struct walk *walk, const uint8_t *owner)
{
    const uint8_t *operation;
    if (walk->operation == 0) {
        walk->fault = BB_UNKNOWN_TYPE;
    }
    if (walk->fault != BB_OK) {
        return;
    }
    encode_fields(walk, owner);
    operation = walk->operation;
    if (walk->fault != BB_OK) {
        return;
    }
    if (operation[0] == BB_OP_ENTRIES) {
        uint8_t count = owner[operation[1]];
        const uint8_t *entry = owner + operation[2];
        if (count < operation[5] || count > operation[6]) {
            walk->fault = BB_BAD_VALUE;
            return;
        }
        while (count != 0u) {
            walk->operation = operation + 7;
            encode_fields(walk, entry);
            entry += operation[3];
            count--;
        }
    } else if (operation[0] == BB_OP_TAIL) {
        const uint8_t *text = *(const uint8_t *const *)(const void *)(owner + operation[1]);
        uint8_t count = owner[operation[2]];
        if (count > operation[3] || count > walk->left) {
            walk->fault = BB_BAD_VALUE;
            return;
        }
        walk->left = (uint8_t)(walk->left - count);
        while (count != 0u) {
            *walk->bytes++ = *text++;
            count--;
        }
    }
}

/* The three steps of a radio payload stand side by side, not in each other: they share no stack. */
#if BB_CODEC_MESSAGES
static void begin_encoding(struct walk *walk, const uint8_t *programme, const uint8_t *header, uint8_t *payload, uint8_t size)
{
    if (size > BB_MAX_RADIO_PAYLOAD) {
        size = BB_MAX_RADIO_PAYLOAD;
    }
    walk->operation = programme;
    walk->bytes = payload;
    walk->left = size < CRC_SIZE ? (uint8_t)0 : (uint8_t)(size - CRC_SIZE);
    walk->fault = BB_OK;
    encode_fields(walk, header);
}

static uint8_t end_encoding(struct walk *walk, uint8_t *payload)
{
    uint8_t length = (uint8_t)(walk->bytes - payload);
    uint16_t crc;
    if (walk->fault != BB_OK) {
        return 0;
    }
    payload[1] = BB_PROTOCOL_VERSION;
    crc = bb_crc16(payload, length);
    payload[length] = (uint8_t)(crc >> 8);
    payload[length + 1u] = (uint8_t)(crc & 0xFFu);
    return (uint8_t)(length + CRC_SIZE);
}

uint8_t bb_encode_uplink(const struct bb_uplink *message, uint8_t *payload, uint8_t size)
{
    struct walk walk;
    begin_encoding(&walk, bb_uplink_header_programme, (const uint8_t *)&message->header, payload, size);
    walk.operation = find_programme(bb_uplink_layouts, BB_N_UPLINK_LAYOUTS, message->header.type);
    encode_body(&walk, (const uint8_t *)&message->body);
    return has_impossible_part(message) ? (uint8_t)0 : end_encoding(&walk, payload);
}

uint8_t bb_encode_downlink(const struct bb_downlink *message, uint8_t *payload, uint8_t size)
{
    struct walk walk;
    begin_encoding(&walk, bb_downlink_header_programme, (const uint8_t *)&message->header, payload, size);
    walk.operation = find_programme(bb_downlink_layouts, BB_N_DOWNLINK_LAYOUTS, message->header.type);
    encode_body(&walk, (const uint8_t *)&message->body);
    return end_encoding(&walk, payload);
}
#endif

uint8_t bb_encode_envelope(const struct bb_envelope *envelope, uint8_t *body, uint8_t size)
{
    struct walk walk;
    if (size == 0u) {
        return 0;
    }
    walk.operation = find_programme(bb_envelope_layouts, BB_N_ENVELOPE_LAYOUTS, envelope->type);
    body[0] = envelope->type;
    walk.bytes = body + 1;
    walk.left = (uint8_t)(size - 1u);
    walk.fault = BB_OK;
    encode_body(&walk, (const uint8_t *)&envelope->body);
    return walk.fault == BB_OK ? (uint8_t)(walk.bytes - body) : (uint8_t)0;
}

/* --- encounters -------------------------------------------------------------------------------------------------------------- */

uint32_t bb_encounter_duration_ms(uint8_t duration_high, uint16_t duration_low)
{
    return (uint32_t)(duration_high & DURATION_BITS) << 16 | duration_low;
}

bool bb_encounter_is_ongoing(uint8_t duration_high)
{
    return (duration_high & ONGOING_BIT) != 0u;
}

uint8_t bb_encounter_duration_high(uint32_t duration_ms, bool is_ongoing)
{
    uint8_t high = (uint8_t)(duration_ms >> 16 & DURATION_BITS);
    return is_ongoing ? (uint8_t)(high | ONGOING_BIT) : high;
}
