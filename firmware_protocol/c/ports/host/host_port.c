#include "host_port.h"

#include <string.h>

static uint32_t now;
static uint16_t uart_room;
static uint8_t uart[BB_HOST_UART_SIZE];
static uint32_t uart_length;
static struct bb_host_sent sent[BB_HOST_RADIO_SIZE];
static uint8_t n_sent;
static uint8_t radio_room;
static struct bb_network network;

static const uint8_t eui64[8] = {0x01, 0, 0, 0, 0, 0x4B, 0x12, 0x00}; /* of Texas Instruments' range */

void bb_host_start(void)
{
    now = 0;
    uart_room = UINT16_MAX;
    uart_length = 0;
    n_sent = 0;
    radio_room = BB_HOST_RADIO_SIZE;
    network.pan_id = 0xB10B;
    network.channel = 20;
    network.permit_join_s = 254;
}

void bb_host_set_now_ms(uint32_t now_ms)
{
    now = now_ms;
}

void bb_host_set_uart_room(uint16_t room)
{
    uart_room = room;
}

uint16_t bb_host_take_uart(uint8_t *bytes, uint16_t size)
{
    uint16_t length = uart_length < size ? (uint16_t)uart_length : size;
    memcpy(bytes, uart, length);
    uart_length -= length;
    memmove(uart, uart + length, uart_length);
    return length;
}

void bb_host_set_radio_room(uint8_t n_payloads)
{
    radio_room = n_payloads < BB_HOST_RADIO_SIZE ? n_payloads : BB_HOST_RADIO_SIZE;
}

bool bb_host_take_sent(struct bb_host_sent *out)
{
    if (n_sent == 0u) {
        return false;
    }
    *out = sent[0];
    n_sent--;
    memmove(sent, sent + 1, n_sent * sizeof sent[0]);
    return true;
}

uint32_t bb_port_now_ms(void)
{
    return now;
}

uint16_t bb_port_uart_room(void)
{
    uint32_t left = BB_HOST_UART_SIZE - uart_length;
    return left < uart_room ? (uint16_t)left : uart_room;
}

void bb_port_uart_write(const uint8_t *bytes, uint8_t length)
{
    memcpy(uart + uart_length, bytes, length);
    uart_length += length;
    if (uart_room != UINT16_MAX) {
        uart_room = (uint16_t)(uart_room - length);
    }
}

bool bb_port_radio_send(uint16_t handle, uint16_t destination, const uint8_t *payload, uint8_t length)
{
    if (n_sent >= radio_room) {
        return false;
    }
    sent[n_sent].handle = handle;
    sent[n_sent].destination = destination;
    sent[n_sent].length = length;
    memcpy(sent[n_sent].payload, payload, length);
    n_sent++;
    return true;
}

void bb_port_network(struct bb_network *out)
{
    *out = network;
}

uint8_t bb_port_set_network(const struct bb_network *wish)
{
    if (wish->pan_id != BB_PAN_LEAVE) {
        network.pan_id = wish->pan_id;
    }
    if (wish->channel != BB_CHANNEL_LEAVE) {
        network.channel = wish->channel;
    }
    if (wish->permit_join_s != BB_JOIN_LEAVE) {
        network.permit_join_s = wish->permit_join_s;
    }
    return BB_NETWORK_DONE;
}

void bb_port_eui64(uint8_t out[8])
{
    memcpy(out, eui64, sizeof eui64);
}

uint32_t bb_host_decode_frames(struct bb_frame_decoder *decoder, const uint8_t *bytes, uint32_t length, uint8_t *results)
{
    uint32_t at = 0;
    while (length != 0u) {
        uint8_t result = bb_frame_decode(decoder, *bytes++);
        length--;
        if (result != BB_FRAME_NONE) {
            uint8_t size = result == BB_FRAME_BODY ? decoder->length : (uint8_t)0;
            results[at++] = result;
            results[at++] = size;
            memcpy(results + at, decoder->body, size);
            at += size;
        }
    }
    return at;
}
