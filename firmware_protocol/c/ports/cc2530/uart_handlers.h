/* Handlers of interrupts; to be included where main() is, so that SDCC makes their vectors. */
#ifndef CC2530_UART_HANDLERS_H
#define CC2530_UART_HANDLERS_H

#include "cc2530_registers.h"

void uart_on_receive(void) __interrupt(VECTOR_URX0);
void uart_on_transmit(void) __interrupt(VECTOR_UTX0);

#endif
