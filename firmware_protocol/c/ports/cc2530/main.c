/* The reference coordinator on a CC2530: USART 0 to the base station, its own radio to the backpacks.
 *
 * Compiled and linked with SDCC, and never run on the chip by us: docs/firmware.md says what was run where.
 */
#include "biobot_coordinator.h"
#include "port.h"
#include "uart_handlers.h"

#define LOG_OCTETS_LOST 1u

static __xdata struct radio_frame heard;
static bool has_heard;

/* A payload for which the coordinator has no room waits here; what comes after it waits in the radio, and is lost when that is full: the
 * backpack, which hears no Acknowledge of the base station, repeats it. */
static void take_from_radio(void)
{
    if (!has_heard) {
        has_heard = radio_read(&heard);
    }
    if (has_heard && bb_coordinator_radio_received(heard.source, heard.rssi_dbm, heard.lqi, heard.payload, heard.length)) {
        has_heard = false;
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

void main(void)
{
    uint8_t octet, status;
    uint16_t handle;
    clock_start();
    uart_start();
    radio_start();
    bb_coordinator_start();
    for (;;) {
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
}
