/* The radio of the CC2530 as a plain IEEE 802.15.4 PAN coordinator (SWRU191F chapter 23): short address 0, no security, no beacons.
 *
 * Backpacks send data frames to address 0 of the PAN from a short address of their own, as their node number and the network decide; the
 * radio's hardware checks, acknowledges and filters them. This is no ZigBee stack: for ZigBee networks there are dongles with one
 * (dialects xbee and znp). Joining is therefore not supported, and addresses are those that backpacks use.
 */
#include "bb_port.h"
#include "biobot_coordinator.h"
#include "cc2530_registers.h"
#include "port.h"

#define FIRST_CHANNEL 11u
#define CHANNEL_STEP 5u /* [MHz], 23.5 of the guide */
#define OUR_ADDRESS 0x0000u
#define BROADCAST 0xFFFFu
#define RSSI_OFFSET 73 /* [dB], CC2530 data sheet SWRS081B */

/* Frame control field, IEEE 802.15.4-2006 7.2.1.1, low byte and high byte: PAN id compressed, short addresses. */
#define FCF_LOW_TYPE 0x07u
#define FCF_LOW_DATA 0x01u
#define FCF_LOW_ACK 0x02u
#define FCF_LOW_SECURED 0x08u
#define FCF_LOW_ACK_REQUEST 0x20u
#define FCF_LOW_COMPRESSED 0x40u
#define FCF_HIGH_ADDRESSES 0xCCu
#define FCF_HIGH_SHORT 0x88u

#define MAC_HEADER 9u /* control 2, sequence 1, PAN 2, destination 2, source 2 */
#define FCS 2u
#define ACK_LENGTH (3u + FCS)
#define MAX_FRAME 127u

/* Of IEEE 802.15.4-2006 7.4.2. An acknowledgement takes 0.9 ms at most; the clock's tick rounds it to 2 ms. */
#define MAX_BACKOFFS 4u
#define MAX_RETRIES 3u
#define ACK_WAIT_MS 2u
#define QUEUE BB_COORDINATOR_RADIO_QUEUE

struct sending {
    uint16_t handle;
    uint16_t destination;
    uint8_t length;
    uint8_t payload[RADIO_MAX_PAYLOAD];
};

enum radio_state { RADIO_IDLE, RADIO_BACKOFF, RADIO_ON_AIR, RADIO_AWAITS_ACK };

static __xdata struct sending queue[QUEUE];
static uint8_t queue_head, queue_used;
static uint8_t state;
static uint32_t wait_since_ms;
static uint8_t wait_ms;
static uint8_t backoff_exponent, n_backoffs, n_retries;
static uint8_t sequence;
static bool is_acknowledged;
static __xdata struct bb_network network = {0xB10Bu, 20u, 254u};

static void apply_network(void)
{
    RFST = ISRFOFF;
    FREQCTRL = (uint8_t)(FIRST_CHANNEL + (uint8_t)((uint8_t)(network.channel - FIRST_CHANNEL) * CHANNEL_STEP));
    PAN_ID0 = (uint8_t)(network.pan_id & 0xFFu);
    PAN_ID1 = (uint8_t)(network.pan_id >> 8);
    RFST = ISFLUSHRX;
    RFST = ISFLUSHRX; /* twice, 23.8.2 of the guide */
    RFST = ISRXON;
}

void radio_start(void)
{
    /* Values that the guide asks for in place of those at reset, table 23-6 and 23.8.1. */
    AGCCTRL1 = 0x15;
    TXFILTCFG = 0x09;
    FSCAL1 = 0x00;
    CCACTRL0 = 0xF8;
    TXPOWER = 0xD5; /* 1 dBm, SWRS081B */
    FIFOPCTRL = MAX_FRAME;
    FRMCTRL0 = 0x60; /* checksums and acknowledgements by the hardware */
    FRMFILT0 = 0x0F; /* filter on, we are a PAN coordinator, frame versions up to 3 */
    SHORT_ADDR0 = (uint8_t)(OUR_ADDRESS & 0xFFu);
    SHORT_ADDR1 = (uint8_t)(OUR_ADDRESS >> 8);
    queue_head = 0;
    queue_used = 0;
    state = RADIO_IDLE;
    apply_network();
}

void bb_port_network(struct bb_network *to)
{
    *to = network;
}

uint8_t bb_port_set_network(const struct bb_network *wish)
{
    if (wish->permit_join_s != BB_JOIN_LEAVE && wish->permit_join_s != network.permit_join_s) {
        return BB_NETWORK_NOT_SUPPORTED;
    }
    if (wish->pan_id != BB_PAN_LEAVE) {
        network.pan_id = wish->pan_id;
    }
    if (wish->channel != BB_CHANNEL_LEAVE) {
        network.channel = wish->channel;
    }
    apply_network();
    return BB_NETWORK_DONE;
}

void bb_port_eui64(uint8_t eui64[8])
{
    uint8_t i;
    for (i = 0; i < 8u; i++) {
        eui64[i] = INFORMATION_EUI64[i];
    }
}

bool bb_port_radio_send(uint16_t handle, uint16_t destination, const uint8_t *payload, uint8_t length)
{
    __xdata struct sending *to;
    uint8_t i;
    if (queue_used == QUEUE || length > RADIO_MAX_PAYLOAD) {
        return false;
    }
    to = &queue[(uint8_t)(queue_head + queue_used) % QUEUE];
    to->handle = handle;
    to->destination = destination;
    to->length = length;
    for (i = 0; i < length; i++) {
        to->payload[i] = payload[i];
    }
    queue_used++;
    return true;
}

static void skip(uint8_t n)
{
    for (; n != 0u; n--) {
        (void)RFD;
    }
}

/* Drop what the radio holds; after an overflow, and where a length makes no sense. */
static void flush(void)
{
    RFST = ISFLUSHRX;
    RFST = ISFLUSHRX;
    RFERRF = (uint8_t)~RFERRF_RXOVERF;
}

static uint16_t read_u16(void)
{
    uint16_t low = RFD;
    return (uint16_t)(low | (uint16_t)RFD << 8);
}

bool radio_read(__xdata struct radio_frame *frame)
{
    while (FSMSTAT1 & FSMSTAT1_FIFOP) {
        uint8_t length, control_low, control_high, number, i, quality;
        if (!(FSMSTAT1 & FSMSTAT1_FIFO)) { /* overflow, 23.9.5 of the guide */
            flush();
            return false;
        }
        length = RFD;
        if (length > MAX_FRAME || length < ACK_LENGTH) {
            flush();
            return false;
        }
        control_low = RFD;
        control_high = RFD;
        number = RFD;
        if (length == ACK_LENGTH) {
            skip(1); /* the signal strength */
            if ((RFD & 0x80u) != 0u && (control_low & FCF_LOW_TYPE) == FCF_LOW_ACK && number == sequence) {
                is_acknowledged = true;
            }
            continue;
        }
        if ((control_low & (FCF_LOW_TYPE | FCF_LOW_SECURED | FCF_LOW_COMPRESSED)) != (FCF_LOW_DATA | FCF_LOW_COMPRESSED)
            || (control_high & FCF_HIGH_ADDRESSES) != FCF_HIGH_SHORT || length < MAC_HEADER + FCS
            || length > MAC_HEADER + FCS + RADIO_MAX_PAYLOAD) {
            skip((uint8_t)(length - 3u));
            continue;
        }
        skip(4); /* our PAN and our address, or the broadcast's: the filter has seen to it */
        frame->source = read_u16();
        frame->length = (uint8_t)(length - (MAC_HEADER + FCS));
        for (i = 0; i < frame->length; i++) {
            frame->payload[i] = RFD;
        }
        frame->rssi_dbm = (int8_t)((int8_t)RFD - RSSI_OFFSET);
        quality = RFD;
        /* Correlation of 50 to 110, made 0 to 255 as IEEE 802.15.4-2006 6.9.8 asks. */
        frame->lqi = (quality & 0x7Fu) <= 50u ? 0u : (quality & 0x7Fu) >= 110u ? 255u : (uint8_t)(((quality & 0x7Fu) - 50u) * 17u / 4u);
        if (quality & 0x80u) {
            return true;
        }
    }
    return false;
}

static void wait(uint8_t next_state, uint8_t duration_ms)
{
    state = next_state;
    wait_since_ms = bb_port_now_ms();
    wait_ms = duration_ms;
}

static bool is_over(void)
{
    return bb_port_now_ms() - wait_since_ms > wait_ms;
}

/* A random delay of up to 2^exponent - 1 periods of 0.32 ms, rounded down to the clock's milliseconds. */
static void back_off(void)
{
    uint8_t random = RFRND & 3u; /* two bits of noise at a time, 23.12 of the guide */
    random = (uint8_t)(random << 2 | (RFRND & 3u));
    random = (uint8_t)(random << 2 | (RFRND & 3u));
    wait(RADIO_BACKOFF, (uint8_t)((random & (uint8_t)((1u << backoff_exponent) - 1u)) / 3u));
}

static void begin(void)
{
    backoff_exponent = 3;
    n_backoffs = 0;
    back_off();
}

static void load(const __xdata struct sending *from)
{
    uint8_t i;
    RFST = ISFLUSHTX;
    RFD = (uint8_t)(from->length + MAC_HEADER + FCS);
    RFD = from->destination == BROADCAST ? (FCF_LOW_DATA | FCF_LOW_COMPRESSED) : (FCF_LOW_DATA | FCF_LOW_COMPRESSED | FCF_LOW_ACK_REQUEST);
    RFD = FCF_HIGH_SHORT;
    RFD = sequence;
    RFD = (uint8_t)(network.pan_id & 0xFFu);
    RFD = (uint8_t)(network.pan_id >> 8);
    RFD = (uint8_t)(from->destination & 0xFFu);
    RFD = (uint8_t)(from->destination >> 8);
    RFD = (uint8_t)(OUR_ADDRESS & 0xFFu);
    RFD = (uint8_t)(OUR_ADDRESS >> 8);
    for (i = 0; i < from->length; i++) {
        RFD = from->payload[i];
    }
}

/* Return a bb_radio_status where the oldest payload is done with; -1 where it is not. */
static int16_t advance(void)
{
    const __xdata struct sending *one = &queue[queue_head];
    switch (state) {
    case RADIO_IDLE:
        sequence++;
        is_acknowledged = false;
        n_retries = 0;
        load(one);
        begin();
        break;
    case RADIO_BACKOFF:
        if (!is_over() || (FSMSTAT1 & FSMSTAT1_TX_ACTIVE) != 0u) {
            break;
        }
        RFIRQF1 = (uint8_t)~RFIRQF1_TXDONE;
        RFST = ISTXONCCA;
        if (FSMSTAT1 & FSMSTAT1_SAMPLED_CCA) {
            wait(RADIO_ON_AIR, 10u); /* the longest frame takes 4.3 ms */
        } else if (++n_backoffs > MAX_BACKOFFS) {
            return BB_RADIO_CHANNEL_BUSY;
        } else {
            if (backoff_exponent < 5u) {
                backoff_exponent++;
            }
            back_off();
        }
        break;
    case RADIO_ON_AIR:
        if (RFIRQF1 & RFIRQF1_TXDONE) {
            if (one->destination == BROADCAST) {
                return BB_RADIO_SENT;
            }
            wait(RADIO_AWAITS_ACK, ACK_WAIT_MS);
        } else if (is_over()) {
            return BB_RADIO_OTHER;
        }
        break;
    default:
        if (is_acknowledged) {
            return BB_RADIO_SENT;
        }
        if (is_over()) {
            if (++n_retries > MAX_RETRIES) {
                return BB_RADIO_NO_ACK;
            }
            load(one);
            begin();
        }
        break;
    }
    return -1;
}

bool radio_poll(uint16_t *handle, uint8_t *status)
{
    int16_t outcome;
    if (queue_used == 0u) {
        return false;
    }
    outcome = advance();
    if (outcome < 0) {
        return false;
    }
    *handle = queue[queue_head].handle;
    *status = (uint8_t)outcome;
    queue_head = (uint8_t)((queue_head + 1u) % QUEUE);
    queue_used--;
    state = RADIO_IDLE;
    return true;
}
