/* The message side of a backpack: what is numbered, kept and repeated until the base station has it on disk, and what a backpack owes an
 * answer to (WIRE_FORMAT.md sections 5.12 and 6.8). Sensing, stimulating and the radio are the owner's.
 *
 * A backpack's main loop sends what bb_backpack_next hands out, passes what the radio hears to bb_backpack_receive, and reports. No clock and
 * no chance of its own: both are arguments.
 */
#ifndef BIOBOT_BACKPACK_H
#define BIOBOT_BACKPACK_H

#include "biobot_codec.h"

/* Messages that may be under way; 68 bytes each. The last two are for answers alone, as the last two numbers are (WIRE_FORMAT.md section
 * 5.1). */
#ifndef BB_BACKPACK_SLOTS
#define BB_BACKPACK_SLOTS 8u
#endif

/* Commands that are remembered, so that each is obeyed once; 32 is what the format asks for. */
#ifndef BB_BACKPACK_COMMANDS
#define BB_BACKPACK_COMMANDS 32u
#endif

enum bb_stimulation_result {
    BB_STIMULATION_DONE = 0,
    BB_STIMULATION_ALREADY_DONE = 1,
    BB_STIMULATION_EXPIRED = 2,
    BB_STIMULATION_REFUSED_LIMIT = 3,
    BB_STIMULATION_BAD_PARAMETER = 4
};

struct bb_backpack_slot {
    uint32_t due_ms;
    uint16_t sequence;
    uint8_t n_sent;
    uint8_t length; /* 0: free */
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
};

struct bb_backpack_command {
    uint32_t command;
    uint32_t executed_ms;
    uint8_t result; /* 0xFF until it is answered */
    uint8_t mode;
    bool is_owed; /* answered by the owner, and there was no room yet to say so */
};

struct bb_backpack {
    struct bb_hello hello;
    uint16_t node;
    uint16_t boot;
    uint16_t next_sequence;
    uint16_t hello_sequence; /* number of the Hello that says what hello does */
    uint16_t sync_token;
    uint32_t sync_received_ms;
    uint32_t spread_command; /* the last stop that came by broadcast */
    uint32_t spread_until_ms; /* and before when it is not answered */
    uint32_t answer_at_ms; /* no answer to the last request for a Hello or a ConfigurationReport goes before this */
    uint16_t n_ignored; /* payloads that were no message for this backpack; modulo 2^16 */
    uint8_t n_commands; /* remembered; the oldest is overwritten */
    uint8_t next_command;
    bool is_sync_owed;
    bool is_hello_owed;
    bool is_hello_told; /* hello_sequence means something */
    bool is_limits_owed;
    bool is_spread; /* spread_command means something */
    struct bb_backpack_slot slots[BB_BACKPACK_SLOTS];
    struct bb_backpack_command commands[BB_BACKPACK_COMMANDS];
};

/* Begin a boot, whose number is one more than the last one's, with a Hello as its first message. */
void bb_backpack_start(struct bb_backpack *backpack, uint16_t node, uint16_t boot, const struct bb_hello *hello, uint32_t now_ms);

/* What the Hello says has changed, such as the beacon period by a Configure: another follows. */
void bb_backpack_describe(struct bb_backpack *backpack, const struct bb_hello *hello, uint32_t now_ms);

/* Give a message its number and keep it; header.type and body are the owner's, the rest of the header is filled in. False: there is no room,
 * or it is outside the format's limits; the owner keeps it. */
bool bb_backpack_report(struct bb_backpack *backpack, struct bb_uplink *message, uint32_t now_ms);

/* A Hello went out or was asked for, and the owner owes the Limits that follow it: bb_backpack_report. */
bool bb_backpack_owes_limits(const struct bb_backpack *backpack);

/* Write the next payload to send now, with the time of sending; 0: none. chance: 16 random bits, so that backpacks that began together do not
 * collide for ever. */
uint8_t bb_backpack_next(struct bb_backpack *backpack, uint32_t now_ms, uint16_t chance, uint8_t payload[BB_MAX_RADIO_PAYLOAD]);

/* Take a payload from the radio. True: message is a Stimulate that was not heard before, a Configure or a ConfigurationRequest, and the owner
 * owes it an answer: bb_backpack_answer, or a ConfigurationReport at once. is_broadcast: it was sent to all; what answers it then goes after a
 * random wait, whenever it is reported, and of Stimulates only a stop is taken. chance: 16 random bits, others than bb_backpack_next had. */
bool bb_backpack_receive(struct bb_backpack *backpack, const uint8_t *payload, uint8_t length, bool is_broadcast, uint32_t now_ms,
                         uint16_t chance, struct bb_downlink *message);

/* Answer a Stimulate, once: a bb_stimulation_result, when it was obeyed or decided, and the mode after it. Where there is no room it is said
 * when there is. */
void bb_backpack_answer(struct bb_backpack *backpack, uint32_t command, uint8_t result, uint32_t executed_ms, uint8_t mode,
                        uint32_t now_ms);

/* The radio has joined another coordinator: whatever waits for a repetition goes now. */
void bb_backpack_hurry(struct bb_backpack *backpack, uint32_t now_ms);

/* When bb_backpack_next has something; false: not before something happens. */
bool bb_backpack_next_deadline(const struct bb_backpack *backpack, uint32_t now_ms, uint32_t *at_ms);

#endif
