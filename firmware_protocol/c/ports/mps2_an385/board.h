/* What the board's parts offer each other. */
#ifndef BOARD_H
#define BOARD_H

#include <stdint.h>

#define BOARD_LOG_OCTETS_LOST 1U /* number of a line in the base station's log */

/* startup.c */
void board_restart(void) __attribute__((noreturn));

/* uart.c: UART 0, driven by interrupts through two rings. */
void board_uart_start(void);
uint16_t board_uart_read(uint8_t *to, uint16_t size);
uint16_t board_uart_room(void);
void board_uart_write(const uint8_t *from, uint16_t size);
uint16_t board_uart_lost(void); /* octets that came while the ring was full, modulo 65536 */
void board_on_uart0_receive(void);
void board_on_uart0_transmit(void);

/* clock.c */
void board_clock_start(void);
uint32_t board_clock_ms(void);
void board_on_systick(void);
void board_sleep(void); /* until an interrupt, at most a millisecond */

#endif
