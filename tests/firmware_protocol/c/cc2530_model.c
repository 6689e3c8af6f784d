/* A CC2530 as far as its port needs one: a radio whose peer acknowledges every unicast, a serial line without limits, a clock that is set.
 *
 * The main loop and the radio's driver are the port's own files (-Dmain=cc2530_main); clock and USART are modelled. Facts of the radio: TI's
 * guide SWRU191F, chapter 23.
 */
#include "main.c"

#include "cc2530_registers.h"

#include <string.h>

#define FIFO_SIZE 128u
#define LINE_SIZE 65536u
#define ADDRESS_OF_FSMSTAT1 0x6193u
#define GOOD_AND_NEAR (0x80u | 105u) /* the checksum is good; correlation */

volatile uint8_t RFIRQF1, RFERRF, RFST;
const uint8_t model_eui64[8] = {1, 0, 0, 0, 0, 0x4B, 0x12, 0};

static volatile uint8_t registers[0x1000]; /* from 0x6000 on */
static volatile uint8_t received[FIFO_SIZE], sent[FIFO_SIZE];
static uint8_t n_received, n_sent;
static bool is_writing, has_overflowed;
static uint16_t n_transmissions;
static uint32_t now_ms;
static uint8_t from_line[LINE_SIZE], to_line[LINE_SIZE];
static uint32_t n_from_line, n_read, n_to_line;

static bool fill(const uint8_t *frame, uint8_t length)
{
    if (has_overflowed || length > FIFO_SIZE - n_received) {
        has_overflowed = true;
        return false;
    }
    for (uint8_t i = 0; i < length; i++) {
        received[n_received++] = frame[i];
    }
    return true;
}

static void transmit(void)
{
    const uint8_t acknowledgement[] = {5, 0x02, 0x00, sent[3], 200, GOOD_AND_NEAR};
    n_transmissions++;
    RFIRQF1 |= RFIRQF1_TXDONE;
    if ((sent[1] & 0x20u) != 0u) {
        (void)fill(acknowledgement, sizeof acknowledgement);
    }
}

volatile uint8_t *model_fifo(void)
{
    static volatile uint8_t octet;
    if (RFST == ISFLUSHTX) {
        RFST = 0;
        n_sent = 0;
        is_writing = true;
    }
    if (is_writing) {
        return &sent[n_sent++ % FIFO_SIZE];
    }
    octet = received[0];
    for (uint8_t i = 1; i < n_received; i++) {
        received[i - 1u] = received[i];
    }
    n_received = (uint8_t)(n_received == 0u ? 0u : n_received - 1u);
    return &octet;
}

volatile uint8_t *model_register(uint16_t address)
{
    uint8_t state = 0;
    if (address != ADDRESS_OF_FSMSTAT1) {
        return &registers[address - 0x6000u];
    }
    is_writing = false;
    if (RFST == ISFLUSHRX) {
        n_received = 0;
        has_overflowed = false;
    } else if (RFST == ISTXONCCA) {
        transmit();
        state = FSMSTAT1_SAMPLED_CCA;
    }
    RFST = 0;
    if (has_overflowed) {
        state |= FSMSTAT1_FIFOP;
    } else if (n_received != 0u) {
        state |= FSMSTAT1_FIFOP | FSMSTAT1_FIFO;
    }
    registers[address - 0x6000u] = state;
    return &registers[address - 0x6000u];
}

/* --- clock and USART, in place of the port's ---------------------------------------------------------------------------------- */

void clock_start(void)
{
    now_ms = 0;
}

uint32_t bb_port_now_ms(void)
{
    return now_ms;
}

void uart_start(void)
{
    n_from_line = n_read = n_to_line = 0;
}

bool uart_read(uint8_t *octet)
{
    if (n_read == n_from_line) {
        n_read = n_from_line = 0;
        return false;
    }
    *octet = from_line[n_read++];
    return true;
}

uint16_t uart_lost(void)
{
    return 0;
}

uint16_t bb_port_uart_room(void)
{
    return (uint16_t)(LINE_SIZE - n_to_line > 0xFFFFu ? 0xFFFFu : LINE_SIZE - n_to_line);
}

void bb_port_uart_write(const uint8_t *bytes, uint8_t length)
{
    memcpy(to_line + n_to_line, bytes, length);
    n_to_line += length;
}

/* --- what the test does ------------------------------------------------------------------------------------------------------- */

void model_start(void)
{
    n_received = n_sent = 0;
    is_writing = has_overflowed = false;
    n_transmissions = 0;
    RFST = RFIRQF1 = 0;
    start();
}

/* A millisecond goes by, and the main loop goes round four times. */
void model_run_a_millisecond(void)
{
    now_ms++;
    for (uint8_t i = 0; i < 4u; i++) {
        turn();
    }
}

/* A backpack's payload arrives in the radio; false: its FIFO is full. */
bool model_hear(uint16_t source, const uint8_t *payload, uint8_t length)
{
    uint8_t frame[FIFO_SIZE] = {(uint8_t)(length + 11u), 0x61, 0x88, 1, 0x0B, 0xB1, 0, 0, (uint8_t)(source & 0xFFu), (uint8_t)(source >> 8)};
    memcpy(frame + 10, payload, length);
    frame[length + 10u] = 200;
    frame[length + 11u] = GOOD_AND_NEAR;
    return fill(frame, (uint8_t)(length + 12u));
}

void model_feed(const uint8_t *bytes, uint16_t length)
{
    memcpy(from_line + n_from_line, bytes, length);
    n_from_line += length;
}

uint16_t model_take(uint8_t *bytes)
{
    uint16_t length = (uint16_t)n_to_line;
    memcpy(bytes, to_line, n_to_line);
    n_to_line = 0;
    return length;
}

uint16_t model_transmissions(void)
{
    return n_transmissions;
}
