#include "biobot_link.h"

enum frame_kind { RESET = 1, RESET_ACK = 2, DATA = 3, ACK = 4, PING = 5, NEED_RESET = 6 };

/* Control frames that wait, by the order in which they go: an answer to RESET before what is said in the new session. */
#define PENDING_NEED_RESET 0x01u
#define PENDING_RESET 0x02u
#define PENDING_RESET_ACK 0x04u
#define PENDING_ACK 0x08u
#define PENDING_PING 0x10u

#define TIMER_RETRANSMIT 0x01u
#define TIMER_RESET 0x02u
#define TIMER_PING 0x04u

static bool is_initiator(const struct bb_link *link)
{
#if BB_LINK_INITIATOR
    return link->role == BB_LINK_INITIATOR_ROLE;
#else
    (void)link;
    return false;
#endif
}

static bool is_due(uint32_t at_ms, uint32_t now_ms)
{
    return now_ms - at_ms < 0x80000000u;
}

/* --- the ring ---------------------------------------------------------------------------------------------------------------- */

static uint16_t ring_index(const struct bb_link *link, uint16_t offset)
{
    uint16_t left = (uint16_t)(link->queue_size - link->head);
    return offset < left ? (uint16_t)(link->head + offset) : (uint16_t)(offset - left);
}

static uint8_t ring_get(const struct bb_link *link, uint16_t offset)
{
    return link->queue[ring_index(link, offset)];
}

static void ring_put(struct bb_link *link, uint16_t offset, uint8_t byte)
{
    link->queue[ring_index(link, offset)] = byte;
}

static uint16_t record_size(const struct bb_link *link, uint16_t offset)
{
    return (uint16_t)(ring_get(link, offset) + BB_LINK_RECORD_OVERHEAD);
}

static void drop_oldest(struct bb_link *link)
{
    uint16_t size = record_size(link, 0);
    link->head = ring_index(link, size);
    link->used = (uint16_t)(link->used - size);
    link->n_in_flight--;
    if (link->n_sent != 0u) {
        link->n_sent--;
        link->cursor = (uint16_t)(link->cursor - size);
    }
}

#if BB_LINK_INITIATOR
static uint16_t drop_all(struct bb_link *link)
{
    uint16_t n_dropped = 0;
    link->n_in_flight = 0;
    link->n_sent = 0;
    link->cursor = 0;
    while (link->used != 0u) {
        uint16_t size = record_size(link, 0);
        link->head = ring_index(link, size);
        link->used = (uint16_t)(link->used - size);
        n_dropped++;
    }
    return n_dropped;
}

static uint16_t record_tag(const struct bb_link *link, uint16_t offset)
{
    unsigned low = ring_get(link, (uint16_t)(offset + 1u));
    unsigned high = ring_get(link, (uint16_t)(offset + 2u));
    return (uint16_t)(high << 8 | low);
}
#endif

/* --- sessions ---------------------------------------------------------------------------------------------------------------- */

static void forget_receipts(struct bb_link *link)
{
    link->next_receipt = (uint16_t)(link->next_receipt + link->n_unconfirmed);
    link->n_unconfirmed = 0;
}

static void begin_session(struct bb_link *link, uint16_t session)
{
    link->session = session;
    link->pending = 0;
    link->timers = 0;
    forget_receipts(link);
    link->first_unacknowledged = 0;
    link->next_expected = 0;
    link->n_confirmed = 0;
    link->n_silent = 0;
#if BB_LINK_INITIATOR
    link->n_fruitless = 0;
#endif
    link->n_repeating = 0;
    link->n_in_flight = 0; /* what was in flight is sent first in the new session */
    link->n_sent = 0;
    link->cursor = 0;
}

static void heard(struct bb_link *link, uint32_t now_ms)
{
    link->n_silent = 0;
#if BB_LINK_INITIATOR
    if (is_initiator(link)) {
        link->ping_at_ms = now_ms + BB_LINK_KEEPALIVE_MS;
        link->timers |= TIMER_PING;
    }
#else
    (void)now_ms;
#endif
}

static void opened(struct bb_link *link, uint32_t now_ms, struct bb_link_event *event)
{
    link->state = BB_LINK_OPEN;
    link->retransmit_ms = BB_LINK_RETRANSMIT_MS;
    link->timers &= (uint8_t)~TIMER_RESET;
    heard(link, now_ms);
    event->kind = BB_LINK_OPENED;
}

static void lose(struct bb_link *link, uint8_t reason, struct bb_link_event *event)
{
    link->state = BB_LINK_CLOSED;
    link->pending = 0;
    link->timers = 0;
    forget_receipts(link);
    event->kind = BB_LINK_LOST;
    event->reason = reason;
#if BB_LINK_INITIATOR
    event->n_dropped = is_initiator(link) ? drop_all(link) : 0u;
#endif
}

/* The link version that RESET and RESET_ACK carry; the first firmware's carry none, which means 1. */
static uint8_t version_in(const uint8_t *payload, uint8_t length)
{
    return length != 0u ? payload[0] : (uint8_t)1;
}

static void accept_reset(struct bb_link *link, uint16_t session, const uint8_t *payload, uint8_t length, uint32_t now_ms,
                         struct bb_link_event *event)
{
    uint8_t newest = version_in(payload, length);
    if (newest == 0u) {
        link->n_ignored++;
        return;
    }
    if (link->state == BB_LINK_OPEN && session == link->session) {
        link->pending |= PENDING_RESET_ACK; /* our answer was lost; the session has begun and goes on */
        return;
    }
    begin_session(link, session);
    link->version = newest < BB_LINK_VERSION ? newest : (uint8_t)BB_LINK_VERSION;
    link->pending = PENDING_RESET_ACK;
    opened(link, now_ms, event);
}

#if BB_LINK_INITIATOR
static void take_reset_ack(struct bb_link *link, uint8_t version, uint32_t now_ms, struct bb_link_event *event)
{
    if (version == 0u || version > BB_LINK_VERSION) {
        link->n_ignored++; /* it chose what was not offered; RESET is sent again */
        return;
    }
    link->version = version;
    opened(link, now_ms, event);
}
#endif

static void take_data(struct bb_link *link, uint8_t sequence, const uint8_t *payload, uint8_t length, struct bb_link_event *event)
{
    if (sequence != link->next_expected || link->is_holding || link->n_unconfirmed == UINT16_MAX) {
        link->pending |= PENDING_ACK;
        return;
    }
    link->next_expected++;
    event->kind = BB_LINK_PAYLOAD;
    event->payload = payload;
    event->length = length;
    event->receipt = (uint16_t)(link->next_receipt + link->n_unconfirmed);
    link->n_unconfirmed++;
}

/* Send all that is in flight again. An ACK without progress brings that about again only when a payload has arrived that is sent for the
 * first time after this: what is repeated needlessly is answered so as well. */
static void repeat_window(struct bb_link *link, uint32_t now_ms)
{
    link->n_sent = 0;
    link->cursor = 0;
    link->n_repeating = (uint8_t)(link->n_in_flight + 1u);
    link->retransmit_at_ms = now_ms + link->retransmit_ms;
}

static void take_acknowledgement(struct bb_link *link, uint8_t sequence, uint32_t now_ms, struct bb_link_event *event)
{
    uint8_t n = (uint8_t)(sequence - link->first_unacknowledged);
    if (n > link->n_in_flight) {
        link->n_ignored++;
        return;
    }
    if (n == 0u) {
        if (link->n_in_flight != 0u && link->n_repeating == 0u) {
            repeat_window(link, now_ms);
        }
        return;
    }
#if BB_LINK_INITIATOR
    link->n_fruitless = 0;
#endif
    link->n_repeating = link->n_repeating > n ? (uint8_t)(link->n_repeating - n) : (uint8_t)0;
    event->kind = BB_LINK_CONFIRMED;
    event->n_confirmed = n;
    while (n != 0u) {
#if BB_LINK_INITIATOR
        event->tags[event->n_confirmed - n] = record_tag(link, 0);
#endif
        drop_oldest(link);
        n--;
    }
    link->first_unacknowledged = sequence;
    link->retransmit_ms = BB_LINK_RETRANSMIT_MS;
    link->retransmit_at_ms = now_ms + BB_LINK_RETRANSMIT_MS;
    if (link->n_in_flight == 0u) {
        link->timers &= (uint8_t)~TIMER_RETRANSMIT;
    }
}

/* --- what the owner calls ---------------------------------------------------------------------------------------------------- */

void bb_link_start(struct bb_link *link, uint8_t role, uint8_t *queue, uint16_t queue_size)
{
    link->queue = queue;
    link->queue_size = queue_size;
    link->head = 0;
    link->used = 0;
    link->next_receipt = 0;
    link->n_unconfirmed = 0;
    begin_session(link, 0);
    link->retransmit_ms = BB_LINK_RETRANSMIT_MS;
    link->n_ignored = 0;
    link->n_repeated = 0;
#if BB_LINK_INITIATOR
    link->receipt_at_repetition = 0;
    link->role = role;
#else
    (void)role;
#endif
    link->state = BB_LINK_CLOSED;
    link->version = BB_LINK_VERSION;
    link->is_holding = false;
}

uint16_t bb_link_free(const struct bb_link *link)
{
    return (uint16_t)(link->queue_size - link->used);
}

uint8_t bb_link_room(const struct bb_link *link)
{
    uint16_t left = bb_link_free(link);
    if (left <= BB_LINK_RECORD_OVERHEAD) {
        return 0;
    }
    left = (uint16_t)(left - BB_LINK_RECORD_OVERHEAD);
    return left < BB_LINK_MAX_PAYLOAD ? (uint8_t)left : (uint8_t)BB_LINK_MAX_PAYLOAD;
}

static bool has_room(const struct bb_link *link, uint8_t length)
{
    return length <= BB_LINK_MAX_PAYLOAD && length + BB_LINK_RECORD_OVERHEAD <= bb_link_free(link);
}

static void put_payload(struct bb_link *link, uint16_t at, const uint8_t *payload, uint8_t length)
{
    uint8_t i;
    ring_put(link, at, length);
    at = (uint16_t)(at + BB_LINK_RECORD_OVERHEAD);
    for (i = 0; i < length; i++) {
        ring_put(link, (uint16_t)(at + i), payload[i]);
    }
    link->used = (uint16_t)(link->used + length + BB_LINK_RECORD_OVERHEAD);
}

bool bb_link_send(struct bb_link *link, const uint8_t *payload, uint8_t length)
{
#if BB_LINK_INITIATOR
    return bb_link_send_tagged(link, 0, payload, length, false);
#else
    if (!has_room(link, length)) {
        return false;
    }
    put_payload(link, link->used, payload, length);
    return true;
#endif
}

void bb_link_receive(struct bb_link *link, const uint8_t *body, uint8_t length, uint32_t now_ms, struct bb_link_event *event)
{
    uint8_t kind;
    uint16_t session;
    event->kind = BB_LINK_NOTHING;
    if (length < BB_LINK_HEADER_SIZE) {
        link->n_ignored++;
        return;
    }
    kind = body[0];
    session = (uint16_t)((unsigned)body[1] | (unsigned)body[2] << 8);
    length = (uint8_t)(length - BB_LINK_HEADER_SIZE);
    if (kind == RESET && !is_initiator(link)) {
        accept_reset(link, session, body + BB_LINK_HEADER_SIZE, length, now_ms, event);
        return;
    }
#if BB_LINK_INITIATOR
    if (kind == NEED_RESET && is_initiator(link) && link->state == BB_LINK_OPEN) {
        lose(link, BB_LINK_PEER_RESTARTED, event);
        return;
    }
#endif
    if (session != link->session || link->state == BB_LINK_CLOSED) {
        link->n_ignored++;
        if (!is_initiator(link) && (kind == DATA || kind == PING)) {
            link->pending |= PENDING_NEED_RESET;
        }
        return;
    }
#if BB_LINK_INITIATOR
    if (link->state == BB_LINK_OPENING) {
        if (kind == RESET_ACK) {
            take_reset_ack(link, version_in(body + BB_LINK_HEADER_SIZE, length), now_ms, event);
        }
        return;
    }
#endif
    heard(link, now_ms);
    if (kind == DATA) {
        take_data(link, body[3], body + BB_LINK_HEADER_SIZE, length, event);
    } else if (kind == ACK) {
        take_acknowledgement(link, body[3], now_ms, event);
    } else if (kind == PING) {
        link->pending |= PENDING_ACK;
    } else if (kind != RESET_ACK) {
        link->n_ignored++;
    }
}

void bb_link_confirm(struct bb_link *link, uint16_t receipt)
{
    uint16_t n = (uint16_t)(receipt - link->next_receipt);
    if (n >= link->n_unconfirmed) {
        return;
    }
    n++;
    link->next_receipt = (uint16_t)(link->next_receipt + n);
    link->n_unconfirmed = (uint16_t)(link->n_unconfirmed - n);
    link->n_confirmed = (uint8_t)(link->n_confirmed + n);
    link->pending |= PENDING_ACK;
}

/* Take the control frame that goes first; 0: none waits. */
static uint8_t next_control(struct bb_link *link)
{
    static const uint8_t kinds[] = {NEED_RESET, RESET, RESET_ACK, ACK, PING};
    uint8_t i;
    for (i = 0; i < sizeof kinds; i++) {
        uint8_t bit = (uint8_t)(1u << i);
        if ((link->pending & bit) != 0u) {
            link->pending &= (uint8_t)~bit;
            return kinds[i];
        }
    }
    return 0;
}

/* Write the payload of the next DATA frame and return its length; the cursor goes on to the record behind it. */
static uint8_t next_data(struct bb_link *link, uint8_t *payload, uint32_t now_ms)
{
    uint8_t length = ring_get(link, link->cursor);
    uint16_t at = (uint16_t)(link->cursor + BB_LINK_RECORD_OVERHEAD);
    uint8_t i;
    for (i = 0; i < length; i++) {
        payload[i] = ring_get(link, (uint16_t)(at + i));
    }
    link->cursor = (uint16_t)(at + length);
    if (link->n_sent == link->n_in_flight) {
        link->n_in_flight++;
    } else {
        link->n_repeated++;
    }
    link->n_sent++;
    if ((link->timers & TIMER_RETRANSMIT) == 0u) {
        link->retransmit_at_ms = now_ms + link->retransmit_ms;
        link->timers |= TIMER_RETRANSMIT;
    }
    return length;
}

uint8_t bb_link_next_frame(struct bb_link *link, uint8_t *body, uint32_t now_ms)
{
    uint8_t kind = next_control(link);
    uint8_t length = 0;
    body[3] = 0;
    if (kind == ACK) {
        body[3] = link->n_confirmed;
    } else if (kind == RESET) {
        body[BB_LINK_HEADER_SIZE] = BB_LINK_VERSION;
        length = 1;
    } else if (kind == RESET_ACK) {
        body[BB_LINK_HEADER_SIZE] = link->version;
        length = 1;
    } else if (kind == 0u) {
        if (link->state != BB_LINK_OPEN || link->cursor == link->used || link->n_sent == BB_LINK_WINDOW) {
            return 0;
        }
        kind = DATA;
        body[3] = (uint8_t)(link->first_unacknowledged + link->n_sent);
        length = next_data(link, body + BB_LINK_HEADER_SIZE, now_ms);
    }
    body[0] = kind;
    body[1] = (uint8_t)(link->session & 0xFFu);
    body[2] = (uint8_t)(link->session >> 8);
    return (uint8_t)(length + BB_LINK_HEADER_SIZE);
}

#if BB_LINK_INITIATOR
/* Count a repetition; true: there were too many of them. An owner that has not confirmed what had come at the last one stalls the peer,
 * which may then have no room for an answer: that is not the peer's fault. */
static bool is_fruitless(struct bb_link *link)
{
    uint16_t n_older = (uint16_t)(link->receipt_at_repetition - link->next_receipt);
    link->n_fruitless = n_older != 0u && n_older <= link->n_unconfirmed ? (uint8_t)0 : (uint8_t)(link->n_fruitless + 1u);
    link->receipt_at_repetition = (uint16_t)(link->next_receipt + link->n_unconfirmed);
    return link->n_fruitless > BB_LINK_MAX_FRUITLESS_RETRIES;
}
#endif

void bb_link_poll(struct bb_link *link, uint32_t now_ms, struct bb_link_event *event)
{
    event->kind = BB_LINK_NOTHING;
#if BB_LINK_INITIATOR
    if ((link->timers & TIMER_RESET) != 0u && is_due(link->reset_at_ms, now_ms)) {
        link->pending |= PENDING_RESET;
        link->reset_at_ms = now_ms + BB_LINK_RESET_RETRY_MS;
    }
#endif
    if ((link->timers & TIMER_RETRANSMIT) != 0u && is_due(link->retransmit_at_ms, now_ms)) {
        if (link->n_silent >= BB_LINK_MAX_SILENT_RETRIES) {
            lose(link, BB_LINK_NO_ANSWER, event);
            return;
        }
#if BB_LINK_INITIATOR
        if (is_initiator(link) && is_fruitless(link)) {
            lose(link, BB_LINK_NO_PROGRESS, event);
            return;
        }
#endif
        link->n_silent++;
        link->retransmit_ms = (uint16_t)(link->retransmit_ms * 2u);
        if (link->retransmit_ms > BB_LINK_MAX_RETRANSMIT_MS) {
            link->retransmit_ms = BB_LINK_MAX_RETRANSMIT_MS;
        }
        repeat_window(link, now_ms);
    }
#if BB_LINK_INITIATOR
    if ((link->timers & TIMER_PING) != 0u && is_due(link->ping_at_ms, now_ms)) {
        if (link->n_silent >= BB_LINK_MAX_SILENT_RETRIES) {
            lose(link, BB_LINK_NO_ANSWER, event);
            return;
        }
        link->n_silent++;
        link->pending |= PENDING_PING;
        link->ping_at_ms = now_ms + BB_LINK_RETRANSMIT_MS;
    }
#endif
}

/* The earlier of two instants as seen from now; what is past is earliest. */
static uint32_t earlier(uint32_t a_ms, uint32_t b_ms, uint32_t now_ms)
{
    int32_t a = (int32_t)(a_ms - now_ms);
    int32_t b = (int32_t)(b_ms - now_ms);
    return a < b ? a_ms : b_ms;
}

bool bb_link_next_deadline(const struct bb_link *link, uint32_t now_ms, uint32_t *at_ms)
{
    uint32_t at = now_ms + 0x7FFFFFFFu;
    if ((link->timers & TIMER_RETRANSMIT) != 0u) {
        at = earlier(at, link->retransmit_at_ms, now_ms);
    }
#if BB_LINK_INITIATOR
    if ((link->timers & TIMER_RESET) != 0u) {
        at = earlier(at, link->reset_at_ms, now_ms);
    }
    if ((link->timers & TIMER_PING) != 0u) {
        at = earlier(at, link->ping_at_ms, now_ms);
    }
#endif
    *at_ms = at;
    return link->timers != 0u;
}

void bb_link_announce_restart(struct bb_link *link)
{
    link->pending |= PENDING_NEED_RESET;
}

#if BB_LINK_INITIATOR
uint16_t bb_link_open(struct bb_link *link, uint16_t session, uint32_t now_ms)
{
    uint16_t n_dropped = drop_all(link);
    begin_session(link, session);
    link->state = BB_LINK_OPENING;
    link->pending = PENDING_RESET;
    link->reset_at_ms = now_ms + BB_LINK_RESET_RETRY_MS;
    link->timers = TIMER_RESET;
    return n_dropped;
}

bool bb_link_send_tagged(struct bb_link *link, uint16_t tag, const uint8_t *payload, uint8_t length, bool is_urgent)
{
    uint16_t at = link->used;
    if (!has_room(link, length)) {
        return false;
    }
    if (is_urgent) {
        /* Behind what was sent, whose numbers are given; the rest moves up, last byte first. */
        uint16_t from = 0;
        uint16_t by = (uint16_t)(length + BB_LINK_RECORD_OVERHEAD);
        uint8_t i;
        for (i = 0; i < link->n_in_flight; i++) {
            from = (uint16_t)(from + record_size(link, from));
        }
        while (at != from) {
            at--;
            ring_put(link, (uint16_t)(at + by), ring_get(link, at));
        }
    }
    put_payload(link, at, payload, length);
    ring_put(link, (uint16_t)(at + 1u), (uint8_t)(tag & 0xFFu));
    ring_put(link, (uint16_t)(at + 2u), (uint8_t)(tag >> 8));
    return true;
}
#endif
