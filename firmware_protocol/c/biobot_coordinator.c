#include "biobot_coordinator.h"

#include "biobot_frame.h"
#include "biobot_link.h"

static uint8_t queue[BB_COORDINATOR_QUEUE_SIZE];
static struct bb_link link;
static struct bb_frame_decoder decoder;
static struct bb_coordinator_counters counters;

void bb_coordinator_start(void)
{
    static const struct bb_coordinator_counters none;
    counters = none;
    bb_frame_decoder_start(&decoder);
    bb_link_start(&link, BB_LINK_RESPONDER_ROLE, queue, BB_COORDINATOR_QUEUE_SIZE);
    bb_link_announce_restart(&link);
}

bool bb_coordinator_is_open(void)
{
    return link.state == BB_LINK_OPEN;
}

const struct bb_coordinator_counters *bb_coordinator_counters(void)
{
    return &counters;
}
