#include "bb_bench_radio.h"

#include "bb_bench_backpack.h"
#include "bb_bench_encounters.h"
#include "biobot_coordinator.h"

#define FIRST_ADDRESS 0x1000u /* short address of backpack 0, which is not there */
#define BROADCAST 0xFFFFu
#define DOWNLINKS BB_COORDINATOR_RADIO_QUEUE
#define AIR_MS 2u           /* a payload down takes this long */
#define UPLINKS_PER_POLL 2u /* 250 kbit/s carry no more in a millisecond or two */
#define LQI 200u
#define NEAREST_DBM (-50)
#define OCTETS_OF_EUI64 8u

/* Both stand there only where the backpacks do: memory at power-on is anything. */
#define MAGIC 0xB10B0A75u

struct downlink {
    uint32_t due_ms;
    uint16_t handle;
    uint16_t destination;
    uint8_t length;
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
};

struct kept {
    volatile uint32_t magic, not_magic;
    uint32_t bench_ms;
    struct bb_network network;
    uint8_t n_joined;
    struct bb_bench_backpack backpacks[BB_BENCH_NODES];
};

static struct kept kept BB_BENCH_KEPT;
static struct downlink downlinks[DOWNLINKS];
static uint8_t first_downlink, n_downlinks, next_to_speak;
static uint32_t last_poll_ms;

static uint32_t tick_of(const struct bb_bench_backpack *backpack)
{
    return kept.bench_ms + backpack->messages.node * BB_BENCH_SKEW_MS;
}

void bb_bench_start(uint32_t now_ms)
{
    static const struct bb_network network = {0xB10Bu, 20u, 254u};
    uint8_t i;
    bool is_known = kept.magic == MAGIC && kept.not_magic == ~MAGIC;
    if (!is_known) {
        kept.bench_ms = BB_BENCH_START_MS;
        kept.network = network;
        kept.n_joined = 0;
    }
    for (i = 0; i < BB_BENCH_NODES; i++) {
        struct bb_bench_backpack *one = &kept.backpacks[i];
        if (is_known) {
            bb_bench_backpack_wake(one);
        } else {
            bb_bench_backpack_boot(one, (uint8_t)(i + 1u), BB_BENCH_START_MS + (i + 1u) * BB_BENCH_SKEW_MS);
        }
    }
    kept.magic = MAGIC;
    kept.not_magic = ~MAGIC;
    last_poll_ms = now_ms;
}

static void tell_joined(void)
{
    uint8_t eui64[OCTETS_OF_EUI64] = {0, BB_BENCH_EUI64_1, 0, 0, 0, 0, 0, 0};
    while (kept.n_joined < BB_BENCH_NODES) {
        eui64[0] = (uint8_t)(kept.n_joined + 1u);
        if (!bb_coordinator_node_joined((uint16_t)(FIRST_ADDRESS + kept.n_joined + 1u), eui64)) {
            return;
        }
        kept.n_joined++;
    }
}

static void deliver(const struct downlink *one)
{
    uint8_t status = BB_RADIO_NO_ACK; /* nobody has this address */
    uint8_t i;
    for (i = 0; i < BB_BENCH_NODES; i++) {
        struct bb_bench_backpack *to = &kept.backpacks[i];
        if (one->destination == BROADCAST || one->destination == FIRST_ADDRESS + to->messages.node) {
            bb_bench_backpack_hear(to, one->payload, one->length, one->destination == BROADCAST, tick_of(to));
            status = BB_RADIO_SENT;
        }
    }
    bb_coordinator_radio_sent(one->handle, one->destination == BROADCAST ? (uint8_t)BB_RADIO_SENT : status);
}

static void go_down(uint32_t now_ms)
{
    while (n_downlinks != 0u && now_ms - downlinks[first_downlink].due_ms < 0x80000000u) {
        deliver(&downlinks[first_downlink]);
        first_downlink = (uint8_t)((first_downlink + 1u) % DOWNLINKS);
        n_downlinks--;
    }
}

/* What the coordinator has no room for is lost on the air: its backpack repeats it. */
static void go_up(void)
{
    uint8_t payload[BB_MAX_RADIO_PAYLOAD];
    uint8_t n_sent = 0, n_silent = 0;
    while (n_sent < UPLINKS_PER_POLL && n_silent < BB_BENCH_NODES) {
        struct bb_bench_backpack *from = &kept.backpacks[next_to_speak];
        uint16_t node = from->messages.node;
        uint8_t length = bb_bench_backpack_speak(from, tick_of(from), payload);
        next_to_speak = (uint8_t)((next_to_speak + 1u) % BB_BENCH_NODES);
        if (length == 0u) {
            n_silent++;
            continue;
        }
        (void)bb_coordinator_radio_received((uint16_t)(FIRST_ADDRESS + node), (int8_t)(NEAREST_DBM - (int16_t)node), LQI, payload, length);
        n_silent = 0;
        n_sent++;
    }
}

void bb_bench_poll(uint32_t now_ms)
{
    kept.bench_ms += now_ms - last_poll_ms;
    last_poll_ms = now_ms;
    tell_joined();
    go_down(now_ms);
    go_up();
}

/* --- the radio's part of bb_port.h ------------------------------------------------------------------------------------------- */

bool bb_port_radio_send(uint16_t handle, uint16_t destination, const uint8_t *payload, uint8_t length)
{
    struct downlink *to = &downlinks[(first_downlink + n_downlinks) % DOWNLINKS];
    uint8_t i;
    if (n_downlinks == DOWNLINKS || length > BB_MAX_RADIO_PAYLOAD) {
        return false;
    }
    to->handle = handle;
    to->destination = destination;
    to->length = length;
    to->due_ms = last_poll_ms + AIR_MS;
    for (i = 0; i < length; i++) {
        to->payload[i] = payload[i];
    }
    n_downlinks++;
    return true;
}

void bb_port_network(struct bb_network *network)
{
    *network = kept.network;
}

uint8_t bb_port_set_network(const struct bb_network *wish)
{
    if (wish->pan_id != BB_PAN_LEAVE) {
        kept.network.pan_id = wish->pan_id;
    }
    if (wish->channel != BB_CHANNEL_LEAVE) {
        kept.network.channel = wish->channel;
    }
    if (wish->permit_join_s != BB_JOIN_LEAVE) {
        kept.network.permit_join_s = wish->permit_join_s;
    }
    return BB_NETWORK_DONE;
}

void bb_port_eui64(uint8_t eui64[8])
{
    static const uint8_t own[OCTETS_OF_EUI64] = {0x85, 0x03, 0, 0, 0, 0x4B, 0x12, 0x00};
    uint8_t i;
    for (i = 0; i < OCTETS_OF_EUI64; i++) {
        eui64[i] = own[i];
    }
}
