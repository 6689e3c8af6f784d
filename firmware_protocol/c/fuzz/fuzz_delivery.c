/* Two ends of a link and a wire that loses, doubles and delays as the input says: what arrives is in order, once, and what was sent.
 *
 * A payload is its own number, so a receiver sees at once what is missing. In the end the wire is made sound, and all that was not dropped
 * must arrive: whatever happened, the link heals.
 */
#include "biobot_link.h"
#include "fuzz_input.h"

#include <string.h>

#define QUEUE_SIZE 120u
#define WIRE 32u
#define FRAME (BB_LINK_HEADER_SIZE + 8u)

struct wire {
    uint8_t body[WIRE][FRAME];
    uint8_t length[WIRE];
    uint8_t n;
};

struct end {
    struct bb_link link;
    uint8_t queue[QUEUE_SIZE];
    struct wire out;
    uint16_t next_given;    /* number of the next payload given to this end */
    uint16_t next_expected; /* lowest number that may still come to this end */
};

static struct end ends[2]; /* initiator, responder */
static uint32_t now_ms;
static uint16_t session;
static uint32_t n_delivered;

static void give(struct end *end)
{
    uint8_t payload[2] = {(uint8_t)(end->next_given & 0xFF), (uint8_t)(end->next_given >> 8)};
    if (bb_link_send(&end->link, payload, sizeof payload)) end->next_given++;
}

/* What an initiator has not seen confirmed may be dropped, so its numbers may skip; a responder's never do. */
static void take(struct end *to, const struct bb_link_event *event)
{
    if (event->kind != BB_LINK_PAYLOAD) return;
    LAW(event->length == 2);
    uint16_t number = (uint16_t)(event->payload[0] | event->payload[1] << 8);
    const struct end *from = to == &ends[0] ? &ends[1] : &ends[0];
    LAW(number >= to->next_expected || (from == &ends[1] && number < to->next_expected));
    LAW(number < from->next_given);
    if (from == &ends[1]) {
        /* A responder repeats in a new session what it has not seen confirmed: older numbers may come again, none is left out. */
        LAW(number <= to->next_expected);
        if (number == to->next_expected) to->next_expected++;
    } else {
        to->next_expected = (uint16_t)(number + 1); /* at most once, in order, also over sessions: a command is never obeyed twice */
    }
    n_delivered++;
    bb_link_confirm(&to->link, event->receipt);
}

static void open_session(void)
{
    (void)bb_link_open(&ends[0].link, ++session, now_ms);
}

static void deliver(struct end *from, uint8_t which, uint8_t keeps)
{
    struct bb_link_event event;
    struct end *to = from == &ends[0] ? &ends[1] : &ends[0];
    if (from->out.n == 0) return;
    which = (uint8_t)(which % from->out.n);
    bb_link_receive(&to->link, from->out.body[which], from->out.length[which], now_ms, &event);
    take(to, &event);
    if (keeps) return; /* it will come again */
    from->out.n--;
    for (uint8_t i = which; i < from->out.n; i++) {
        memcpy(from->out.body[i], from->out.body[i + 1], FRAME);
        from->out.length[i] = from->out.length[i + 1];
    }
}

static void put_on_wire(struct end *end)
{
    while (end->out.n < WIRE) {
        uint8_t length = bb_link_next_frame(&end->link, end->out.body[end->out.n], now_ms);
        if (length == 0) return;
        LAW(length <= FRAME);
        end->out.length[end->out.n++] = length;
    }
}

static void pass_time(uint16_t by_ms)
{
    struct bb_link_event event;
    now_ms += by_ms;
    for (int i = 0; i < 2; i++) bb_link_poll(&ends[i].link, now_ms, &event);
}

static void run_soundly(void)
{
    uint16_t wanted[2] = {ends[1].next_given, ends[0].next_given};
    ends[0].out.n = ends[1].out.n = 0; /* the line is new */
    for (int round = 0; round < 400; round++) {
        if (ends[0].link.state == BB_LINK_CLOSED) open_session();
        for (int i = 0; i < 2; i++) put_on_wire(&ends[i]);
        for (int i = 0; i < 2; i++)
            while (ends[i].out.n) deliver(&ends[i], 0, 0);
        if (ends[0].link.state == BB_LINK_OPEN && ends[1].link.state == BB_LINK_OPEN && ends[0].link.used == 0 && ends[1].link.used == 0) {
            LAW(ends[0].next_expected == wanted[0]);
            LAW(ends[1].next_expected <= wanted[1]);
            return;
        }
        pass_time(100);
    }
    abort(); /* not healed in 40 s of a sound line */
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input input = {data, size};
    memset(ends, 0, sizeof ends);
    bb_link_start(&ends[0].link, BB_LINK_INITIATOR_ROLE, ends[0].queue, QUEUE_SIZE);
    bb_link_start(&ends[1].link, BB_LINK_RESPONDER_ROLE, ends[1].queue, QUEUE_SIZE);
    now_ms = 0xFFFFF000u;
    session = 0;
    n_delivered = 0;
    open_session();
    while (input.left) {
        uint8_t action = take_u8(&input);
        struct end *end = &ends[action >> 7];
        switch (action % 8) {
        case 0:
        case 1:
            give(end);
            break;
        case 2:
            put_on_wire(end);
            break;
        case 3:
        case 4:
            deliver(end, 0, 0);
            break;
        case 5:
            if (action & 0x40 && end->out.n) end->out.n--; /* lost */
            else deliver(end, 0, 1); /* and once more later */
            break;
        case 6:
            pass_time((uint16_t)((action >> 3 & 15) * 100));
            break;
        default:
            if (ends[0].link.state == BB_LINK_CLOSED || (action & 0x78) == 0x78) {
                /* A port that is opened anew has an empty line: a wire keeps nothing from one session for the next. */
                ends[0].out.n = ends[1].out.n = 0;
                open_session();
            }
            break;
        }
    }
    run_soundly();
    return 0;
}
