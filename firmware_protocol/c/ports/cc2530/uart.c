/* USART 0 as a UART at 115200 baud (SWRU191F chapter 16), alternative 1: RX on P0.2, TX on P0.3. */
#include "bb_port.h"
#include "cc2530_registers.h"
#include "port.h"
#include "uart_handlers.h"

#define RING 256u /* an index of 8 bits goes round by itself */

static volatile __xdata uint8_t receive_ring[RING];
static volatile __xdata uint8_t transmit_ring[RING];
/* Head writes, tail reads; a ring with head == tail is empty, so it holds one octet less than it has. */
static volatile uint8_t receive_head, receive_tail, transmit_head, transmit_tail;
static volatile uint16_t receive_lost;
static volatile bool is_transmitting;

/* 115200 baud at 32 MHz: BAUD_M 216, BAUD_E 11 (table 16-1). */
void uart_start(void)
{
    PERCFG &= (uint8_t)~0x01u;
    P0SEL |= 0x0Cu;
    U0CSR = U0CSR_UART;
    U0UCR = U0UCR_FLUSH | U0UCR_8_N_1;
    U0BAUD = 216;
    U0GCR = 11;
    U0CSR = U0CSR_UART | U0CSR_RECEIVE;
    URX0IF = 0;
    UTX0IF = 0;
    URX0IE = 1;
    IEN2 |= IEN2_UTX0;
    EA = 1;
}

void uart_on_receive(void) __interrupt(VECTOR_URX0)
{
    uint8_t octet = U0DBUF;
    uint8_t next = (uint8_t)(receive_head + 1u);
    URX0IF = 0;
    if (next == receive_tail) {
        receive_lost++;
    } else {
        receive_ring[receive_head] = octet;
        receive_head = next;
    }
}

void uart_on_transmit(void) __interrupt(VECTOR_UTX0)
{
    UTX0IF = 0;
    if (transmit_tail == transmit_head) {
        is_transmitting = false;
    } else {
        U0DBUF = transmit_ring[transmit_tail];
        transmit_tail++;
    }
}

bool uart_read(uint8_t *octet)
{
    if (receive_tail == receive_head) {
        return false;
    }
    *octet = receive_ring[receive_tail];
    receive_tail++;
    return true;
}

uint16_t uart_lost(void)
{
    uint16_t lost;
    URX0IE = 0; /* two octets, which an interrupt may change in between */
    lost = receive_lost;
    URX0IE = 1;
    return lost;
}

uint16_t bb_port_uart_room(void)
{
    return (uint8_t)(transmit_tail - transmit_head - 1u);
}

void bb_port_uart_write(const uint8_t *bytes, uint8_t length)
{
    uint8_t i;
    for (i = 0; i < length; i++) {
        transmit_ring[transmit_head] = bytes[i];
        transmit_head++;
    }
    if (!is_transmitting && transmit_tail != transmit_head) {
        /* The handler is not running and will not: the first octet is ours to start. */
        is_transmitting = true;
        U0DBUF = transmit_ring[transmit_tail];
        transmit_tail++;
    }
}
