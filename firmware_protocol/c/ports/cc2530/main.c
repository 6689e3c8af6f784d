/* The reference coordinator on a CC2530: USART 0 to the base station, its own radio to the backpacks.
 *
 * Compiled and linked with SDCC, and never run on the chip by us: docs/firmware.md says what was run where.
 */
#include "biobot_coordinator.h"
#include "port.h"
#include "uart_handlers.h"

#define LOG_OCTETS_LOST 1u

static __xdata struct radio_frame heard;

/* Nothing waits here for room: behind a payload that did, the radio would keep the acknowledgements of what we send. One that the coordinator
 * refuses is dropped and counted, and the backpack, which hears no Acknowledge of the base station, repeats it. */
static void take_from_radio(void)
{
    while (radio_read(&heard)) {
        (void)bb_coordinator_radio_received(heard.source, heard.rssi_dbm, heard.lqi, heard.payload, heard.length);
    }
}

static void report_lost_octets(void)
{
    static const char text[] = "octets lost at the serial line";
    static uint16_t reported;
    uint16_t lost = uart_lost();
    if (lost != reported && bb_coordinator_log(BB_LOG_WARNING, LOG_OCTETS_LOST, text, sizeof text - 1u)) {
        reported = lost;
    }
}

static void start(void)
{
    clock_start();
    uart_start();
    radio_start();
    bb_coordinator_start();
}

/* Once round the main loop. */
static void turn(void)
{
    uint8_t octet, status;
    uint16_t handle;
    while (uart_read(&octet)) {
        bb_coordinator_uart_received(&octet, 1);
    }
    take_from_radio();
    if (radio_poll(&handle, &status)) {
        bb_coordinator_radio_sent(handle, status);
    }
    bb_coordinator_poll();
    report_lost_octets();
}

void main(void)
{
    start();
    for (;;) {
        turn();
    }
}
