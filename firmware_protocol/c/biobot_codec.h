/* Messages and envelopes to bytes and back, by the layouts of biobot_layouts.h (WIRE_FORMAT.md sections 4 to 7). */
#ifndef BIOBOT_CODEC_H
#define BIOBOT_CODEC_H

#include <stdbool.h>
#include <stdint.h>

#include "biobot_layouts.h"

/* 0 leaves the messages of backpacks out: a coordinator carries them and does not read them. On an 8051, whose compiler gives every function
 * some of the 128 octets of fast memory for good, what is left out counts. */
#ifndef BB_CODEC_MESSAGES
#define BB_CODEC_MESSAGES 1
#endif

#define BB_PROTOCOL_VERSION 1u

/* Octets that a ZigBee unicast with APS security still carries in one piece. */
#define BB_MAX_RADIO_PAYLOAD 57u

/* Why bytes are not a message or an envelope. */
enum bb_fault {
    BB_OK = 0,
    BB_BAD_CRC = 1,
    BB_TOO_LONG = 2,
    BB_UNKNOWN_VERSION = 3,
    BB_UNKNOWN_TYPE = 4,
    BB_BAD_LENGTH = 5,
    BB_BAD_VALUE = 6
};

/* header.type says which member of the body there is; the types without one have no fields. */
struct bb_uplink {
    struct bb_uplink_header header;
    union bb_uplink_body body;
};

struct bb_downlink {
    struct bb_downlink_header header;
    union bb_downlink_body body;
};

struct bb_envelope {
    uint8_t type;
    union bb_envelope_body body;
};

/* Each returns a bb_fault; after any but BB_OK the message says nothing. Texts and payloads are pointers into the bytes given. */
uint8_t bb_decode_uplink(const uint8_t *payload, uint8_t length, struct bb_uplink *message);
uint8_t bb_decode_downlink(const uint8_t *payload, uint8_t length, struct bb_downlink *message);
uint8_t bb_decode_envelope(const uint8_t *body, uint8_t length, struct bb_envelope *envelope);

/* Each writes at most size octets and returns how many; 0: the type is not known, a value or a count is outside its limits, or it does
 * not fit. A radio payload never takes more than BB_MAX_RADIO_PAYLOAD. header.version is written as BB_PROTOCOL_VERSION. */
uint8_t bb_encode_uplink(const struct bb_uplink *message, uint8_t *payload, uint8_t size);
uint8_t bb_encode_downlink(const struct bb_downlink *message, uint8_t *payload, uint8_t size);
uint8_t bb_encode_envelope(const struct bb_envelope *envelope, uint8_t *body, uint8_t size);

/* The duration of an encounter [ms], 22 bits, and whether it goes on, out of and into an entry (WIRE_FORMAT.md section 5.3). */
#define BB_MAX_ENCOUNTER_MS 0x3FFFFFul
uint32_t bb_encounter_duration_ms(uint8_t duration_high, uint16_t duration_low);
bool bb_encounter_is_ongoing(uint8_t duration_high);
uint8_t bb_encounter_duration_high(uint32_t duration_ms, bool is_ongoing);

#endif
