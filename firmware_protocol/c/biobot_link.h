/* Reliable, ordered delivery of payloads over one serial line, either end (WIRE_FORMAT.md section 3).
 *
 * A coordinator is the responder; a base station is the initiator, whose code is there with -DBB_LINK_INITIATOR=1 alone. No clock: every
 * call takes now_ms, any counter of milliseconds that wraps at 2^32. No memory but what the owner gives: payloads wait in a ring of bytes
 * until the peer has confirmed them. Frames are made when they are asked for, so a slow line needs no second buffer.
 */
#ifndef BIOBOT_LINK_H
#define BIOBOT_LINK_H

#include <stdbool.h>
#include <stdint.h>

#ifndef BB_LINK_INITIATOR
#define BB_LINK_INITIATOR 0
#endif

#define BB_LINK_VERSION 1u
#define BB_LINK_HEADER_SIZE 4u
#define BB_LINK_MAX_PAYLOAD 240u

/* WIRE_FORMAT.md section 3.4 */
#define BB_LINK_WINDOW 16u
#define BB_LINK_RETRANSMIT_MS 300u
#define BB_LINK_MAX_RETRANSMIT_MS 2000u
#define BB_LINK_MAX_SILENT_RETRIES 5u
#define BB_LINK_MAX_FRUITLESS_RETRIES 10u
#define BB_LINK_KEEPALIVE_MS 3000u
#define BB_LINK_RESET_RETRY_MS 500u

/* Octets that a payload takes in the ring beside its own. */
#if BB_LINK_INITIATOR
#define BB_LINK_RECORD_OVERHEAD 3u
#else
#define BB_LINK_RECORD_OVERHEAD 1u
#endif

enum bb_link_role { BB_LINK_RESPONDER_ROLE = 0, BB_LINK_INITIATOR_ROLE = 1 };
enum bb_link_state { BB_LINK_CLOSED = 0, BB_LINK_OPENING = 1, BB_LINK_OPEN = 2 };

enum bb_link_event_kind {
    BB_LINK_NOTHING = 0,
    BB_LINK_OPENED = 1,    /* a session began */
    BB_LINK_PAYLOAD = 2,   /* payload and length, within the body given; the peer forgets it after bb_link_confirm(receipt) */
    BB_LINK_CONFIRMED = 3, /* the oldest n_confirmed payloads have arrived; an initiator's tags tell which */
    BB_LINK_LOST = 4       /* the session ended, for this reason */
};

enum bb_link_lost { BB_LINK_NO_ANSWER = 0, BB_LINK_PEER_RESTARTED = 1, BB_LINK_PEER_RESET = 2, BB_LINK_NO_PROGRESS = 3 };

struct bb_link_event {
    const uint8_t *payload;
    uint16_t receipt;
    uint8_t length;
    uint8_t kind;
    uint8_t n_confirmed;
    uint8_t reason;
#if BB_LINK_INITIATOR
    uint16_t n_dropped; /* LOST: payloads given to bb_link_send and not CONFIRMED, whose outcome will never be known */
    uint16_t tags[BB_LINK_WINDOW];
#endif
};

struct bb_link {
    uint8_t *queue; /* ring: records of length, an initiator's tag, payload */
    uint32_t retransmit_at_ms;
#if BB_LINK_INITIATOR
    uint32_t reset_at_ms;
    uint32_t ping_at_ms;
    uint16_t receipt_at_repetition; /* that the next payload would have had when the window was last repeated */
    uint8_t n_fruitless;            /* repetitions without progress, not counting those while the owner stalled */
    uint8_t role;                   /* without an initiator's code there is one role */
#endif
    uint16_t queue_size;
    uint16_t head; /* of the oldest record */
    uint16_t used;
    uint16_t cursor; /* of the next record to send, counted from head */
    uint16_t session;
    uint16_t retransmit_ms;
    uint16_t next_receipt;
    uint16_t n_unconfirmed; /* payloads received and not yet confirmed by the owner */
    uint16_t n_ignored;     /* frames that were not of this session or not understood; modulo 2^16, as the next */
    uint16_t n_repeated;    /* DATA frames sent more than once */
    uint8_t state;
    uint8_t version;             /* of the link protocol that both ends speak in this session */
    uint8_t pending;             /* control frames to be sent, a bit each */
    uint8_t timers;              /* which of the deadlines above are set */
    uint8_t n_in_flight;         /* records sent in this session and not acknowledged */
    uint8_t n_sent;              /* of them, sent since the last repetition began */
    uint8_t n_repeating;         /* payloads to be acknowledged before an ACK without progress tells of a loss */
    uint8_t first_unacknowledged;
    uint8_t next_expected;
    uint8_t n_confirmed;
    uint8_t n_silent;
    bool is_holding; /* set by the owner: payloads are not taken now, the peer repeats them */
};

/* queue_size: 16 to 32767; role: where there is no initiator's code, the responder's. The memory stays the owner's, and must outlive the link. */
void bb_link_start(struct bb_link *link, uint8_t role, uint8_t *queue, uint16_t queue_size);

/* The longest payload that bb_link_send takes now, in octets: 0 to BB_LINK_MAX_PAYLOAD. */
uint8_t bb_link_room(const struct bb_link *link);

/* Octets of the ring that are free. */
uint16_t bb_link_free(const struct bb_link *link);

/* Queue a payload; false: too long, or no room. */
bool bb_link_send(struct bb_link *link, const uint8_t *payload, uint8_t length);

/* Take one frame body from the line. */
void bb_link_receive(struct bb_link *link, const uint8_t *body, uint8_t length, uint32_t now_ms, struct bb_link_event *event);

/* Acknowledge to the peer all payloads up to and including this receipt. Receipts of past sessions are ignored. */
void bb_link_confirm(struct bb_link *link, uint16_t receipt);

/* Write the next frame body to be sent to body, which has room for BB_LINK_HEADER_SIZE and the longest payload ever sent.
 * Returns its length; 0: there is none. */
uint8_t bb_link_next_frame(struct bb_link *link, uint8_t *body, uint32_t now_ms);

/* Repeat what was not answered, or give the link up. Calling too early does nothing. */
void bb_link_poll(struct bb_link *link, uint32_t now_ms, struct bb_link_event *event);

/* When bb_link_poll must be called; false: nothing is awaited. */
bool bb_link_next_deadline(const struct bb_link *link, uint32_t now_ms, uint32_t *at_ms);

/* Responder: tell the initiator that this end has just started and knows no session. */
void bb_link_announce_restart(struct bb_link *link);

#if BB_LINK_INITIATOR
/* Begin a session under a number that the last one did not have; RESET is repeated until answered. Payloads that wait are dropped:
 * returns how many. */
uint16_t bb_link_open(struct bb_link *link, uint16_t session, uint32_t now_ms);

/* Queue a payload under a tag of the owner's choice; an urgent one goes ahead of all that was never sent in this session. */
bool bb_link_send_tagged(struct bb_link *link, uint16_t tag, const uint8_t *payload, uint8_t length, bool is_urgent);
#endif

#endif
