/* The whole coordinator between a serial line, a radio and a clock that do as the input says.
 *
 * Laws: every frame it writes is sound and fits the room it was told; the radio is given payloads of 1 to 57 octets, each handle is
 * answered in the end; it never writes on for ever; it ends up able to open a session, whatever came.
 */
#include "biobot_codec.h"
#include "biobot_coordinator.h"
#include "biobot_frame.h"
#include "biobot_link.h"
#include "fuzz_input.h"

#include <string.h>

#define RADIO 24u
#define WRITES_PER_POLL 64u /* a window, its control frames, and frames that waited */

static uint32_t now_ms;
static uint16_t room;
static uint16_t in_radio[RADIO];
static uint8_t n_in_radio, n_writes;
static bool radio_is_full;
static struct bb_network network;
static struct bb_frame_decoder line;
static uint16_t session;    /* of the newest RESET_ACK */
static uint8_t expected;    /* number of the next payload, by the newest ACK */
static bool was_reset;

uint32_t bb_port_now_ms(void) { return now_ms; }

uint16_t bb_port_uart_room(void) { return room; }

void bb_port_uart_write(const uint8_t *octets, uint8_t length)
{
    LAW(length <= room && length <= BB_COORDINATOR_FRAME_SIZE && ++n_writes <= WRITES_PER_POLL);
    room = (uint16_t)(room - length);
    for (uint8_t i = 0; i < length; i++) {
        uint8_t result = bb_frame_decode(&line, octets[i]);
        LAW(result == BB_FRAME_NONE || result == BB_FRAME_BODY);
        if (result != BB_FRAME_BODY) continue;
        const uint8_t *body = line.body;
        LAW(line.length >= BB_LINK_HEADER_SIZE && body[0] >= 2 && body[0] <= 6 && body[0] != 5);
        if (body[0] == 2) {
            session = (uint16_t)(body[1] | body[2] << 8);
            was_reset = true;
            expected = 0;
        } else if (body[0] == 4) {
            expected = body[3];
        } else if (body[0] == 3) { /* data: an envelope of the right direction */
            struct bb_envelope envelope;
            LAW(bb_decode_envelope(body + BB_LINK_HEADER_SIZE, (uint8_t)(line.length - BB_LINK_HEADER_SIZE), &envelope) == BB_OK);
            LAW(envelope.type != BB_TYPE_IDENTIFY_REQUEST && envelope.type != BB_TYPE_RADIO_SEND && envelope.type != BB_TYPE_CONFIGURE_COORDINATOR);
        }
    }
}

bool bb_port_radio_send(uint16_t handle, uint16_t destination, const uint8_t *payload, uint8_t length)
{
    (void)destination;
    LAW(length >= 1 && length <= BB_MAX_RADIO_PAYLOAD);
    uint8_t copy[BB_MAX_RADIO_PAYLOAD];
    memcpy(copy, payload, length); /* all of it must be readable */
    if (radio_is_full || n_in_radio == RADIO) return false;
    in_radio[n_in_radio++] = handle;
    LAW(n_in_radio <= BB_COORDINATOR_RADIO_QUEUE);
    return true;
}

void bb_port_network(struct bb_network *to) { *to = network; }

uint8_t bb_port_set_network(const struct bb_network *wish)
{
    LAW(wish->channel == BB_CHANNEL_LEAVE || (wish->channel >= 11 && wish->channel <= 26));
    if (wish->pan_id & 1) return BB_NETWORK_NOT_SUPPORTED;
    if (wish->channel != BB_CHANNEL_LEAVE) network.channel = wish->channel;
    return BB_NETWORK_DONE;
}

void bb_port_eui64(uint8_t eui64[8]) { memset(eui64, 0x11, 8); }

static void poll_with_room(uint16_t its_room)
{
    uint32_t at_ms;
    room = its_room;
    n_writes = 0;
    bb_coordinator_poll();
    (void)bb_coordinator_next_deadline(&at_ms);
}

/* A link frame with this head and payload, framed and handed over in two pieces. */
static void say(uint8_t kind, uint16_t its_session, uint8_t sequence, const uint8_t *payload, uint8_t length, uint8_t cut)
{
    uint8_t frame[BB_MAX_FRAME_BODY + BB_FRAME_OVERHEAD];
    uint8_t n;
    frame[2] = kind;
    frame[3] = (uint8_t)(its_session & 0xFF);
    frame[4] = (uint8_t)(its_session >> 8);
    frame[5] = sequence;
    memcpy(frame + 6, payload, length);
    n = bb_frame_encode(frame, (uint8_t)(length + BB_LINK_HEADER_SIZE));
    LAW(n != 0);
    cut = (uint8_t)(cut % n);
    bb_coordinator_uart_received(frame, cut);
    bb_coordinator_uart_received(frame + cut, (uint16_t)(n - cut));
}

static void act(struct input *input)
{
    uint8_t action = take_u8(input), length;
    uint16_t number;
    uint8_t *block;
    switch (action % 8) {
    case 0: /* anything on the line */
        block = take_block(input, take_u8(input), &length);
        bb_coordinator_uart_received(block, length);
        free(block);
        break;
    case 1: /* data of the session in force, mostly with the number that is due */
        block = take_block(input, (uint8_t)(take_u8(input) % (BB_LINK_MAX_PAYLOAD + 1u)), &length);
        say(3, session, action & 0x80 ? take_u8(input) : expected++, block, length, action);
        free(block);
        break;
    case 2: /* acknowledgements, pings, resets */
        block = take_block(input, action >> 7, &length);
        number = take_u16(input);
        say((uint8_t)(1 + (action >> 3) % 6), action & 0x40 ? session : number, take_u8(input), block, length, 0);
        free(block);
        break;
    case 3:
        poll_with_room(take_u8(input));
        break;
    case 4: /* from the air */
        block = take_block(input, (uint8_t)(action >> 2), &length);
        number = take_u16(input);
        (void)bb_coordinator_radio_received(number, (int8_t)take_u8(input), action, block, length);
        free(block);
        break;
    case 5:
        if (action & 0x80) {
            bb_coordinator_radio_sent(take_u16(input), action); /* of a handle that was never given, perhaps */
            if (n_in_radio) n_in_radio--;
        } else if (n_in_radio) {
            bb_coordinator_radio_sent(in_radio[--n_in_radio], (uint8_t)(action >> 4));
        }
        break;
    case 6:
        now_ms += action & 0x80 ? (uint32_t)take_u16(input) << 10 : take_u8(input);
        radio_is_full = action & 0x40;
        break;
    default:
        block = take_block(input, (uint8_t)(action >> 1), &length);
        if (length == 8) {
            (void)bb_coordinator_node_joined(action, block);
        } else {
            (void)bb_coordinator_log((uint8_t)(action >> 6), action, (const char *)block, length);
        }
        free(block);
        break;
    }
}

/* Whatever has come: a base station that opens a session gets one, and an answer to what it asks. */
static void check_that_it_lives(void)
{
    static const uint8_t version = BB_LINK_VERSION, identify = BB_TYPE_IDENTIFY_REQUEST, nothing = 0;
    uint16_t fresh = (uint16_t)(session + 1);
    bb_coordinator_uart_received(&nothing, 1); /* ends what was begun */
    was_reset = false;
    say(1, fresh, 0, &version, 1, 0);
    for (int i = 0; i < 3; i++) poll_with_room(4096);
    LAW(was_reset && session == fresh && bb_coordinator_is_open());
    say(3, fresh, 0, &identify, 1, 0);
    for (int i = 0; i < 3; i++) poll_with_room(4096);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct input input = {data, size};
    now_ms = 0xFFFFFE00u;
    room = 0;
    n_in_radio = 0;
    radio_is_full = false;
    session = 0;
    expected = 0;
    network.pan_id = 0xB10B;
    network.channel = 20;
    network.permit_join_s = 0;
    bb_frame_decoder_start(&line);
    bb_coordinator_start();
    while (input.left) act(&input);
    check_that_it_lives();
    return 0;
}
