/* What compiled.py calls of firmware_protocol/c/bulk: it and the portable sources are compiled into _bulk.so by hatch_build.py. */
#include "../../firmware_protocol/c/bulk/biobot_bulk.h"

#define EXPORTED __attribute__((visibility("default")))

EXPORTED void bulk_start(struct bb_frame_decoder *decoder)
{
    bb_frame_decoder_start(decoder);
}

EXPORTED void bulk_decode(struct bb_frame_decoder *decoder, const uint8_t *bytes, uint32_t length, bool is_bare,
                          const struct bb_bulk_columns *columns, struct bb_bulk_progress *progress)
{
    bb_bulk_decode(decoder, bytes, length, is_bare, columns, progress);
}

/* The sizes of the structures, for compiled.py to compare with its own. */
EXPORTED int64_t bulk_layout(void)
{
    return (int64_t)(1000000u * sizeof(struct bb_frame_decoder) + 1000u * sizeof(struct bb_bulk_columns) + sizeof(struct bb_bulk_progress));
}

EXPORTED int64_t bulk_sources(void)
{
    return SOURCES;
}
