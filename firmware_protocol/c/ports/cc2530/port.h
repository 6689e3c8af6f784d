/* What the parts of the port offer each other. */
#ifndef CC2530_PORT_H
#define CC2530_PORT_H

#include <stdbool.h>
#include <stdint.h>

/* uart.c: USART 0 at 115200 baud on P0.2 (RX) and P0.3 (TX), by interrupts through two rings. The handlers are declared where main()
 * is, because SDCC makes the vectors there. */
void uart_start(void);
bool uart_read(uint8_t *octet);
uint16_t uart_lost(void); /* octets that came while the ring was full, modulo 65536 */

/* clock.c */
void clock_start(void);

/* radio.c: IEEE 802.15.4 data frames with short addresses and acknowledgement. */
#define RADIO_MAX_PAYLOAD 57u

struct radio_frame {
    uint16_t source;
    int8_t rssi_dbm;
    uint8_t lqi;
    uint8_t length;
    uint8_t payload[RADIO_MAX_PAYLOAD];
};

void radio_start(void);
bool radio_read(__xdata struct radio_frame *frame); /* a data frame for us has come */
bool radio_poll(uint16_t *handle, uint8_t *status); /* a payload given to bb_port_radio_send is done with */

#endif
