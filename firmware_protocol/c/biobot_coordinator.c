#include "biobot_coordinator.h"

#include "biobot_frame.h"
#include "biobot_link.h"

#define MAX_ENVELOPE (BB_COORDINATOR_FRAME_SIZE - BB_LINK_HEADER_SIZE - BB_FRAME_OVERHEAD)
#define CONFIRM_SIZE 4u
#define MAX_ANSWER 16u /* CoordinatorHello, the longest answer to a request */
#define RECORD(size) ((size) + BB_LINK_RECORD_OVERHEAD)

/* What heard payloads leave of the queue: a confirmation for each payload that the radio holds, and an answer to each request that the
 * base station may have in its window. Without it, a base station whose disk stalls could not have a biobot stopped. */
#define RESERVE (BB_COORDINATOR_RADIO_QUEUE * RECORD(CONFIRM_SIZE) + BB_LINK_WINDOW * RECORD(MAX_ANSWER))

#if BB_COORDINATOR_QUEUE_SIZE < 2 * 8 * 64 || BB_COORDINATOR_QUEUE_SIZE > 32767 || BB_COORDINATOR_RADIO_QUEUE > 100
#error "BB_COORDINATOR_QUEUE_SIZE: 1024 to 32767 bytes; BB_COORDINATOR_RADIO_QUEUE: at most 100"
#endif

/* Static and one of each: members of a known place are cheap on an 8051, and the linker's map tells the RAM. */
static uint8_t queue[BB_COORDINATOR_QUEUE_SIZE];
static struct bb_link line;
static struct bb_frame_decoder decoder;
static struct bb_link_event event;
static struct bb_envelope envelope;
static struct bb_coordinator_counters counters;
static uint8_t frame[BB_COORDINATOR_FRAME_SIZE];
static uint8_t frame_size; /* of a frame that waits for room on the line; 0: none */
static uint8_t n_in_radio;
static bool has_said_hello;

/* --- to the base station ----------------------------------------------------------------------------------------------------- */

/* What of the queue belongs to the confirmations of payloads that the radio holds. */
static uint16_t owed(void)
{
    return (uint16_t)(n_in_radio * RECORD(CONFIRM_SIZE));
}

/* Queue the envelope, leaving this much of the queue; false: no room. */
static bool send_envelope(uint16_t reserve)
{
    uint8_t body[MAX_ENVELOPE];
    uint8_t length = bb_encode_envelope(&envelope, body, (uint8_t)sizeof body);
    if (length == 0u || bb_link_free(&line) < RECORD(length) + reserve) {
        return false;
    }
    return bb_link_send(&line, body, length);
}

static void send_confirm(uint16_t handle, uint8_t status)
{
    envelope.type = BB_TYPE_RADIO_CONFIRM;
    envelope.body.radio_confirm.handle = handle;
    envelope.body.radio_confirm.status = status;
    (void)send_envelope(0); /* it was owed, or there is room: see has_room_for_answer */
}

static void send_hello(void)
{
    struct bb_network network;
    bb_port_network(&network);
    envelope.type = BB_TYPE_COORDINATOR_HELLO;
    envelope.body.coordinator_hello.firmware = BB_COORDINATOR_FIRMWARE;
    bb_port_eui64(envelope.body.coordinator_hello.eui64);
    envelope.body.coordinator_hello.pan_id = network.pan_id;
    envelope.body.coordinator_hello.channel = network.channel;
    envelope.body.coordinator_hello.max_radio_payload = BB_MAX_RADIO_PAYLOAD;
    if (send_envelope(owed())) {
        has_said_hello = true;
    }
}

/* --- from the base station --------------------------------------------------------------------------------------------------- */

/* A request is taken only where there is room for its answer beside the confirmations that are owed; else the base station repeats it.
 * So no answer is ever lost, whatever the base station does. */
static bool has_room_for_answer(void)
{
    return bb_link_free(&line) >= RECORD(MAX_ANSWER) + RECORD(CONFIRM_SIZE) + owed();
}

static void send_to_radio(void)
{
    uint16_t handle = envelope.body.radio_send.handle;
    uint16_t destination = envelope.body.radio_send.destination;
    const uint8_t *payload = envelope.body.radio_send.payload;
    uint8_t length = envelope.body.radio_send.payload_length;
    if (length > BB_MAX_RADIO_PAYLOAD) {
        send_confirm(handle, BB_RADIO_TOO_LONG);
    } else if (length == 0u) {
        send_confirm(handle, BB_RADIO_OTHER); /* no radio sends nothing */
    } else if (n_in_radio >= BB_COORDINATOR_RADIO_QUEUE || !bb_port_radio_send(handle, destination, payload, length)) {
        send_confirm(handle, BB_RADIO_QUEUE_FULL);
    } else {
        n_in_radio++;
    }
}

static void configure(void)
{
    struct bb_network network;
    uint16_t token = envelope.body.configure_coordinator.token;
    uint8_t result;
    network.pan_id = envelope.body.configure_coordinator.pan_id;
    network.channel = envelope.body.configure_coordinator.channel;
    network.permit_join_s = envelope.body.configure_coordinator.permit_join_s;
    if (network.channel != BB_CHANNEL_LEAVE && (network.channel < 11u || network.channel > 26u)) {
        result = BB_NETWORK_BAD;
    } else {
        result = bb_port_set_network(&network);
    }
    bb_port_network(&network);
    envelope.type = BB_TYPE_COORDINATOR_CONFIGURED;
    envelope.body.coordinator_configured.token = token;
    envelope.body.coordinator_configured.result = result;
    envelope.body.coordinator_configured.pan_id = network.pan_id;
    envelope.body.coordinator_configured.channel = network.channel;
    envelope.body.coordinator_configured.permit_join_s = network.permit_join_s;
    (void)send_envelope(owed());
}

static void obey(const uint8_t *payload, uint8_t length)
{
    if (bb_decode_envelope(payload, length, &envelope) != BB_OK) {
        counters.bad_envelopes++;
        return;
    }
    switch (envelope.type) {
    case BB_TYPE_IDENTIFY_REQUEST:
        send_hello();
        break;
    case BB_TYPE_RADIO_SEND:
        send_to_radio();
        break;
    case BB_TYPE_CONFIGURE_COORDINATOR:
        configure();
        break;
    default:
        counters.bad_envelopes++; /* it goes the other way */
        break;
    }
}

static void take_event(void)
{
    if (event.kind == BB_LINK_OPENED && !has_said_hello) {
        send_hello();
    } else if (event.kind == BB_LINK_PAYLOAD) {
        obey(event.payload, event.length);
        bb_link_confirm(&line, event.receipt); /* nothing here outlives a power cut, so there is nothing to wait for */
    }
}

/* --- what a port calls ------------------------------------------------------------------------------------------------------- */

void bb_coordinator_start(void)
{
    counters.bad_frames = 0;
    counters.bad_envelopes = 0;
    counters.refused_payloads = 0;
    counters.lost_reports = 0;
    frame_size = 0;
    n_in_radio = 0;
    has_said_hello = false;
    bb_frame_decoder_start(&decoder);
    bb_link_start(&line, BB_LINK_RESPONDER_ROLE, queue, BB_COORDINATOR_QUEUE_SIZE);
    bb_link_announce_restart(&line);
}

void bb_coordinator_uart_received(const uint8_t *bytes, uint16_t length)
{
    while (length != 0u) {
        uint8_t result = bb_frame_decode(&decoder, *bytes);
        if (result == BB_FRAME_BODY) {
            line.is_holding = !has_room_for_answer();
            bb_link_receive(&line, decoder.body, decoder.length, bb_port_now_ms(), &event);
            take_event();
        } else if (result != BB_FRAME_NONE) {
            counters.bad_frames++;
        }
        bytes++;
        length--;
    }
}

bool bb_coordinator_radio_received(uint16_t source, int8_t rssi_dbm, uint8_t lqi, const uint8_t *payload, uint8_t length)
{
    envelope.type = BB_TYPE_RADIO_RECEIVED;
    envelope.body.radio_received.source = source;
    envelope.body.radio_received.rssi_dbm = rssi_dbm;
    envelope.body.radio_received.lqi = lqi;
    envelope.body.radio_received.payload = payload;
    envelope.body.radio_received.payload_length = length;
    if (length > BB_MAX_RADIO_PAYLOAD || !send_envelope(RESERVE)) {
        counters.refused_payloads++;
        return false;
    }
    return true;
}

void bb_coordinator_radio_sent(uint16_t handle, uint8_t status)
{
    if (n_in_radio == 0u) {
        return; /* no payload was taken since the start: one from before a restart, which nobody waits for */
    }
    n_in_radio--;
    send_confirm(handle, status);
}

bool bb_coordinator_node_joined(uint16_t address, const uint8_t eui64[8])
{
    uint8_t i;
    envelope.type = BB_TYPE_NODE_JOINED;
    envelope.body.node_joined.address = address;
    for (i = 0; i < 8u; i++) {
        envelope.body.node_joined.eui64[i] = eui64[i];
    }
    if (!send_envelope(RESERVE)) {
        counters.lost_reports++;
        return false;
    }
    return true;
}

bool bb_coordinator_log(uint8_t level, uint16_t code, const char *text, uint8_t length)
{
    envelope.type = BB_TYPE_COORDINATOR_LOG;
    envelope.body.coordinator_log.level = level;
    envelope.body.coordinator_log.code = code;
    envelope.body.coordinator_log.text = (const uint8_t *)text;
    envelope.body.coordinator_log.text_length = length;
    if (!send_envelope(RESERVE)) {
        counters.lost_reports++;
        return false;
    }
    return true;
}

void bb_coordinator_poll(void)
{
    uint32_t now_ms = bb_port_now_ms();
    bb_link_poll(&line, now_ms, &event);
    take_event();
    for (;;) {
        if (frame_size == 0u) {
            uint8_t length = bb_link_next_frame(&line, frame + 2, now_ms);
            if (length == 0u) {
                return;
            }
            frame_size = bb_frame_encode(frame, length);
        }
        if (bb_port_uart_room() < frame_size) {
            return;
        }
        bb_port_uart_write(frame, frame_size);
        frame_size = 0;
    }
}

bool bb_coordinator_next_deadline(uint32_t *at_ms)
{
    return bb_link_next_deadline(&line, bb_port_now_ms(), at_ms);
}

bool bb_coordinator_is_open(void)
{
    return line.state == BB_LINK_OPEN;
}

const struct bb_coordinator_counters *bb_coordinator_counters(void)
{
    return &counters;
}
