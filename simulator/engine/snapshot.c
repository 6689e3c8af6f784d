/* Snapshots: plain copies of every array, for a program of the same build. */
#include "state.h"

typedef struct {
    uint8_t *write;
    const uint8_t *read;
    int64_t at, room;
} tape;

static void pass(tape *tape, void *place, int64_t size) {
    if (size > 0 && tape->at + size <= tape->room) { /* an empty array has no place, not even for no bytes */
        if (tape->write) memcpy(tape->write + tape->at, place, (size_t)size);
        if (tape->read) memcpy(place, tape->read + tape->at, (size_t)size);
    }
    tape->at += size;
}

/* Pass a growing array: its count, then its elements; on reading, make the room for them. */
static int pass_array(tape *tape, void **place, int64_t *count, int64_t *room, int64_t size) {
    pass(tape, count, sizeof *count);
    if (tape->read) {
        if (*count < 0 || tape->at > tape->room || *count > (tape->room - tape->at) / size) return -1;
        *room = *count;
        *place = *count ? malloc((size_t)(*count * size)) : NULL;
        if (*count && !*place) return -1;
    }
    pass(tape, *place, *count * size);
    return 0;
}

static int pass_links(tape *tape, links *all) {
    int64_t count = all->count, room = all->room;
    void *at = tape->read ? NULL : all->at;
    if (pass_array(tape, &at, &count, &room, sizeof *all->at)) {
        all->at = NULL;
        all->count = all->room = 0;
        return -1;
    }
    *all = (links){at, (int32_t)count, (int32_t)room};
    return 0;
}

static const uint64_t MARK = 0x62696f626f740004u; /* a word that also tells the byte order, and the version of the layout */

/* Sizes of what crosses the border, for binding.py to compare with its own. */
int64_t engine_layout(void) { return (int64_t)(10000 * sizeof(engine_config) + 100 * sizeof(engine_event) + sizeof(engine_leg)); }

/* The CRC-32 of the sources, given by the build. */
int64_t engine_sources(void) { return SOURCES; }

static int pass_all(tape *tape, engine *e) {
    uint64_t mark = MARK;
    int64_t inside = (int64_t)(1000 * sizeof(insect) + sizeof(pair_event)), layout = 1000000 * engine_layout() + inside, wanted = layout;
    int64_t n_cells = (int64_t)e->columns * e->rows, n_walls = e->walls.n;
    pass(tape, &mark, sizeof mark);
    pass(tape, &layout, sizeof layout);
    if (tape->at > tape->room && tape->read) return -1;
    if (mark != MARK || layout != wanted) return -2;
    pass(tape, &e->config, sizeof e->config);
    pass(tape, &e->n, sizeof e->n);
    pass(tape, &e->columns, sizeof e->columns);
    pass(tape, &e->rows, sizeof e->rows);
    pass(tape, &e->has_started, sizeof e->has_started);
    pass(tape, &e->now, sizeof e->now);
    pass(tape, &e->cell, sizeof e->cell);
    pass(tape, &e->low_x, sizeof e->low_x);
    pass(tape, &e->low_y, sizeof e->low_y);
    pass(tape, &e->n_steps, sizeof e->n_steps);
    pass(tape, &n_walls, sizeof n_walls);
    if (tape->read) {
        n_cells = (int64_t)e->columns * e->rows;
        if (tape->at > tape->room || e->n < 1 || e->columns < 1 || e->rows < 1 || n_walls < 0 || n_walls > INT32_MAX) return -1;
        e->expected_walls = (int32_t)n_walls;
        if (n_cells * 4 + e->n * (int64_t)(sizeof(insect) + sizeof(own_entry)) > tape->room - tape->at) return -1;
        e->insect = calloc((size_t)e->n, sizeof *e->insect);
        e->order = calloc((size_t)e->n, sizeof *e->order);
        e->cells = calloc((size_t)n_cells, sizeof *e->cells);
        if (!e->insect || !e->order || !e->cells) return -1;
    }
    for (int32_t i = 0; i < e->n; i++) {
        insect one = e->insect[i];
        one.near = one.close = (links){NULL, 0, 0}; /* pointers mean nothing elsewhere; the lists follow */
        pass(tape, &one, sizeof one);
        if (tape->read) {
            e->insect[i] = one;
            e->insect[i].near = e->insect[i].close = (links){NULL, 0, 0};
        }
    }
    for (int32_t i = 0; i < e->n; i++)
        if (pass_links(tape, &e->insect[i].near) || pass_links(tape, &e->insect[i].close)) return -1;
    pass(tape, e->order, e->n * (int64_t)sizeof *e->order);
    pass(tape, e->cells, n_cells * (int64_t)sizeof *e->cells);
    void *pairs = e->pairs, *events = e->events, *legs = e->legs;
    int status = pass_array(tape, &pairs, &e->n_pairs, &e->room_pairs, sizeof *e->pairs);
    e->pairs = pairs;
    if (status) return status;
    status = pass_array(tape, &events, &e->n_events, &e->room_events, sizeof *e->events);
    e->events = events;
    if (status) return status;
    status = pass_array(tape, &legs, &e->n_legs, &e->room_legs, sizeof *e->legs);
    e->legs = legs;
    if (status) return status;
    return tape->read && tape->at != tape->room ? -1 : 0;
}

static int is_row(const engine *e, int32_t i) { return i >= 0 && i < e->n; }

static int is_row_or_none(const engine *e, int32_t i) { return i == -1 || is_row(e, i); }

static int is_wall_or_none(const engine *e, int32_t k) { return k >= -1 && k < e->expected_walls; }

static int are_sound(const engine *e, const links *all, int32_t of) {
    for (int32_t k = 0; k < all->count; k++)
        if (!is_row(e, all->at[k].other) || all->at[k].other == of || (k && all->at[k - 1].other >= all->at[k].other)) return 0;
    return 1;
}

static int is_sound_insect(const engine *e, int32_t i) {
    const insect *one = &e->insect[i];
    if (!is_row_or_none(e, one->next_in_cell) || !is_row_or_none(e, one->previous_in_cell)) return 0;
    if (one->cell < 0 || one->cell >= e->columns * (int64_t)e->rows || one->cell != cell_of(e, one->column, one->row)) return 0;
    if (!is_row(e, one->place_in_heap) || e->order[one->place_in_heap].i != i) return 0;
    if (!is_wall_or_none(e, one->wall) || !is_wall_or_none(e, one->passed_wall) || !is_wall_or_none(e, one->touched)) return 0;
    if (one->follows_walls < 0 || one->follows_walls > 1) return 0;
    if (one->activity == FOLLOW || one->resume == FOLLOW)
        if (one->wall < 0 || one->next_wall < 0 || one->next_wall >= e->expected_walls || !is_wall_or_none(e, one->next_passed)) return 0;
    return are_sound(e, &one->near, i) && are_sound(e, &one->close, i);
}

/* Tell whether every index of a snapshot leads somewhere: its bytes may be whole and yet somebody's mischief. */
static int is_sound(const engine *e) {
    for (int32_t i = 0; i < e->n; i++)
        if (!is_sound_insect(e, i)) return 0;
    for (int64_t k = 0; k < (int64_t)e->columns * e->rows; k++)
        if (!is_row_or_none(e, e->cells[k])) return 0;
    for (int64_t k = 0; k < e->n_pairs; k++)
        if (!is_row(e, e->pairs[k].a) || !is_row(e, e->pairs[k].b) || e->pairs[k].a >= e->pairs[k].b) return 0;
    for (int64_t k = 0; k < e->n_events; k++)
        if (!is_row(e, e->events[k].first) || (e->events[k].kind != EVENT_MODE && !is_row_or_none(e, e->events[k].second))) return 0;
    for (int64_t k = 0; k < e->n_legs; k++)
        if (e->legs[k].row < 0 || e->legs[k].row >= e->n) return 0;
    return 1;
}

int32_t engine_count(const engine *e) { return e->n; }

/* Write a snapshot of at most `room` bytes; returns how many it takes. The walls are not in it: set them anew after loading. */
int64_t engine_save(const engine *e, uint8_t *place, int64_t room) {
    tape tape = {place, NULL, 0, place ? room : 0};
    pass_all(&tape, (engine *)e);
    return tape.at;
}

/* Returns NULL where the bytes are no snapshot of this build. */
engine *engine_load(const uint8_t *place, int64_t size) {
    engine *e = calloc(1, sizeof *e);
    tape tape = {NULL, place, 0, size};
    if (!e || (pass_all(&tape, e) == 0 && is_sound(e))) return e;
    engine_free(e);
    return NULL;
}
