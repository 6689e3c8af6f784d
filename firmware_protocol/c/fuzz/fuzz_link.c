/* Either end of a link under frames, owners and clocks of any kind: nothing overflows, windows and queues keep their bounds.
 *
 * The first octet chooses the role; then each octet is an action, followed by what it needs.
 */
#include "biobot_link.h"
#include "fuzz_input.h"

#include <string.h>

#define QUEUE_SIZE 400u
#define MOST_FRAMES (BB_LINK_WINDOW + 8u) /* that one look can bring: a window and one control frame of each kind */

static struct bb_link *link_;
static uint32_t now_ms;
static uint16_t newest_receipt;
static uint32_t n_waiting; /* payloads given and neither confirmed nor dropped */

static void check_bounds(void)
{
    LAW(link_->used <= link_->queue_size && link_->head < link_->queue_size);
    LAW(link_->n_in_flight <= BB_LINK_WINDOW && link_->n_sent <= link_->n_in_flight);
    LAW(link_->cursor <= link_->used);
    LAW(link_->state <= BB_LINK_OPEN);
    LAW(bb_link_room(link_) <= BB_LINK_MAX_PAYLOAD);
    uint32_t at_ms;
    LAW(link_->state != BB_LINK_CLOSED || !bb_link_next_deadline(link_, now_ms, &at_ms));
}

static void look_at(const struct bb_link_event *event, const uint8_t *body, uint8_t length)
{
    LAW(event->kind <= BB_LINK_LOST);
    if (event->kind == BB_LINK_PAYLOAD) {
        LAW(event->payload == body + BB_LINK_HEADER_SIZE && event->length == length - BB_LINK_HEADER_SIZE);
        newest_receipt = event->receipt;
    } else if (event->kind == BB_LINK_CONFIRMED) {
        LAW(event->n_confirmed >= 1 && event->n_confirmed <= BB_LINK_WINDOW && event->n_confirmed <= n_waiting);
        n_waiting -= event->n_confirmed;
    } else if (event->kind == BB_LINK_LOST && link_->role == BB_LINK_INITIATOR_ROLE) {
        LAW(event->n_dropped == n_waiting); /* every payload has an outcome */
        n_waiting = 0;
    }
}

static void take_frames(void)
{
    uint8_t length, n = 0;
    do {
        uint8_t *body = malloc(BB_LINK_HEADER_SIZE + BB_LINK_MAX_PAYLOAD);
        LAW(body != NULL);
        length = bb_link_next_frame(link_, body, now_ms);
        LAW(length == 0 || (length >= BB_LINK_HEADER_SIZE && length <= BB_LINK_HEADER_SIZE + BB_LINK_MAX_PAYLOAD));
        LAW(length == 0 || (body[0] >= 1 && body[0] <= 6));
        free(body);
        LAW(++n <= MOST_FRAMES);
    } while (length != 0);
}

static void act(struct input *input)
{
    struct bb_link_event event;
    uint8_t action = take_u8(input), length;
    uint8_t *block;
    switch (action % 8) {
    case 0: /* any frame */
        block = take_block(input, (uint8_t)(action >> 3), &length);
        bb_link_receive(link_, block, length, now_ms, &event);
        look_at(&event, block, length);
        free(block);
        break;
    case 1: /* a frame of this session, so that more than its header is met */
        block = take_block(input, (uint8_t)(BB_LINK_HEADER_SIZE + (action >> 3)), &length);
        if (length >= BB_LINK_HEADER_SIZE) {
            block[1] = (uint8_t)(link_->session & 0xFF);
            block[2] = (uint8_t)(link_->session >> 8);
            bb_link_receive(link_, block, length, now_ms, &event);
            look_at(&event, block, length);
        }
        free(block);
        break;
    case 2:
        block = take_block(input, take_u8(input), &length);
        if (action & 0x40 && link_->role == BB_LINK_INITIATOR_ROLE) {
            n_waiting += bb_link_send_tagged(link_, action, block, length, action & 0x80);
        } else {
            n_waiting += bb_link_send(link_, block, length);
        }
        free(block);
        break;
    case 3:
        bb_link_confirm(link_, action & 0x80 ? take_u16(input) : newest_receipt);
        break;
    case 4:
        take_frames();
        break;
    case 5: /* a clock may do anything but what it says */
        now_ms += action & 0x80 ? (uint32_t)take_u16(input) << 12 : take_u16(input);
        bb_link_poll(link_, now_ms, &event);
        look_at(&event, NULL, 0);
        break;
    case 6:
        link_->is_holding = action & 0x80;
        break;
    default:
        if (link_->role == BB_LINK_RESPONDER_ROLE) {
            bb_link_announce_restart(link_);
        } else {
            LAW(bb_link_open(link_, take_u16(input), now_ms) == n_waiting);
            n_waiting = 0;
        }
        break;
    }
    check_bounds();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input input = {data, size};
    uint8_t *queue = malloc(QUEUE_SIZE);
    uint8_t first = take_u8(&input);
    link_ = malloc(sizeof *link_);
    LAW(link_ != NULL && queue != NULL);
    memset(link_, 0xA5, sizeof *link_);
    bb_link_start(link_, first & 1 ? BB_LINK_INITIATOR_ROLE : BB_LINK_RESPONDER_ROLE, queue, first & 2 ? 16u : QUEUE_SIZE);
    now_ms = first & 4 ? 0xFFFFFF00u : 0; /* so that the clock also wraps */
    newest_receipt = 0;
    n_waiting = 0;
    while (input.left) act(&input);
    free(link_);
    free(queue);
    return 0;
}
