/* UART 0 of the MPS2 (a CMSDK APB UART) on QEMU's first serial line, by interrupts through two rings.
 *
 * Registers: Cortex-M System Design Kit TRM (DDI 0479) 4.3; addresses and interrupt numbers: Arm AN385. A ring has one writer and one
 * reader, an interrupt and the main loop, so no lock is needed.
 */
#include "board.h"

#define UART_DATA (*(volatile uint32_t *)0x40004000U)
#define UART_STATE (*(volatile uint32_t *)0x40004004U)
#define UART_CONTROL (*(volatile uint32_t *)0x40004008U)
#define UART_INTERRUPT_CLEAR (*(volatile uint32_t *)0x4000400CU)
#define UART_BAUD_DIVISOR (*(volatile uint32_t *)0x40004010U)

#define STATE_TRANSMIT_FULL 0x01U
#define STATE_RECEIVE_FULL 0x02U
#define CONTROL_TRANSMIT_RECEIVE_WITH_INTERRUPTS 0x0FU
#define INTERRUPT_TRANSMIT 0x01U
#define INTERRUPT_RECEIVE 0x02U

#define NVIC_SET_ENABLE (*(volatile uint32_t *)0xE000E100U)
#define NVIC_SET_PENDING (*(volatile uint32_t *)0xE000E200U)
#define IRQ_RECEIVE 0x01U  /* interrupt 0 */
#define IRQ_TRANSMIT 0x02U /* interrupt 1 */

#define CLOCK_HZ 25000000U
#define BAUD 115200U

#define RECEIVE_RING 1024U /* powers of two */
#define TRANSMIT_RING 2048U

static volatile uint8_t receive_ring[RECEIVE_RING];
static volatile uint8_t transmit_ring[TRANSMIT_RING];
static volatile uint32_t receive_head, receive_tail, transmit_head, transmit_tail; /* count on for ever; head writes, tail reads */
static volatile uint16_t receive_lost;

void board_uart_start(void) {
    UART_BAUD_DIVISOR = CLOCK_HZ / BAUD;
    UART_CONTROL = CONTROL_TRANSMIT_RECEIVE_WITH_INTERRUPTS;
    NVIC_SET_ENABLE = IRQ_RECEIVE | IRQ_TRANSMIT;
}

void board_on_uart0_receive(void) {
    UART_INTERRUPT_CLEAR = INTERRUPT_RECEIVE;
    while (UART_STATE & STATE_RECEIVE_FULL) {
        uint8_t octet = (uint8_t)UART_DATA;
        if (receive_head - receive_tail < RECEIVE_RING)
            receive_ring[receive_head++ % RECEIVE_RING] = octet;
        else
            receive_lost++;
    }
}

/* Fills the transmitter; pended by board_uart_write for the first octet, by the UART for each one after it. */
void board_on_uart0_transmit(void) {
    UART_INTERRUPT_CLEAR = INTERRUPT_TRANSMIT;
    while (transmit_tail != transmit_head && !(UART_STATE & STATE_TRANSMIT_FULL)) UART_DATA = transmit_ring[transmit_tail++ % TRANSMIT_RING];
}

uint16_t board_uart_read(uint8_t *to, uint16_t size) {
    uint16_t n = 0;
    while (n < size && receive_tail != receive_head) {
        to[n++] = receive_ring[receive_tail % RECEIVE_RING];
        receive_tail++; /* after the octet is read: the interrupt may use its place at once */
    }
    return n;
}

uint16_t board_uart_room(void) { return (uint16_t)(TRANSMIT_RING - (transmit_head - transmit_tail)); }

void board_uart_write(const uint8_t *from, uint16_t size) {
    for (uint16_t i = 0; i < size && transmit_head - transmit_tail < TRANSMIT_RING; i++) {
        transmit_ring[transmit_head % TRANSMIT_RING] = from[i];
        transmit_head++; /* after the octet is there: the interrupt may take it at once */
    }
    NVIC_SET_PENDING = IRQ_TRANSMIT;
}

uint16_t board_uart_lost(void) { return receive_lost; }
