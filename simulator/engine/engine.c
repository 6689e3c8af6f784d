/* The engine: every insect walks one straight leg at a time, and every change of every leg, contact or sight is one event in order of time.

   Nothing here advances by time steps. An insect's next own event (its leg ends, a hazard strikes, it crosses into another cell) waits in a
   heap of insects; what may happen between two insects on their present legs waits in a heap of pairs and is forgotten when either leg
   changes. Instants of encounters are roots of quadratics of the two legs alone, so neither cells nor chunks of time change a bit of them.
   At one instant insects' own events come first, then those of pairs by kind and rows: equal input gives equal output. */
#include "engine.h"

#include "state.h"

static void free_insects(engine *e) {
    for (int32_t i = 0; e->insect && i < e->n; i++) {
        free(e->insect[i].near.at);
        free(e->insect[i].close.at);
    }
    free(e->insect);
}

void engine_free(engine *e) {
    if (!e) return;
    free_insects(e);
    free(e->cells);
    free(e->order);
    free(e->pairs);
    free(e->near_walls);
    free(e->events);
    free(e->legs);
    walls_free(&e->walls);
    free(e);
}

engine *engine_create(const engine_config *config, int32_t n, const uint64_t *ids, const double *xy, const double *silent_from_s) {
    engine *e = calloc(1, sizeof *e);
    if (!e) return NULL;
    e->config = *config;
    e->n = n;
    e->expected_walls = -1;
    e->insect = calloc((size_t)n, sizeof *e->insect);
    e->order = calloc((size_t)n, sizeof *e->order);
    if (!e->insect || !e->order) {
        engine_free(e);
        return NULL;
    }
    for (int32_t i = 0; i < n; i++) {
        insect *one = &e->insect[i];
        one->id = ids[i];
        one->x = xy[2 * i];
        one->y = xy[2 * i + 1];
        one->silent_from = silent_from_s[i];
        one->wall = one->passed_wall = one->touched = -1;
        one->stop_left = draw_exponential(e, one, STOP, 0);
        one->mishap_left = draw_exponential(e, one, MISHAP, 0);
        one->death_left = draw_exponential(e, one, DEATH, 0);
        one->t_own = INFINITY;
        one->place_in_heap = i;
        e->order[i] = (own_entry){INFINITY, i};
    }
    return e;
}

int engine_set_walls(engine *e, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin) {
    if (e->expected_walls >= 0 && e->expected_walls != n) return -3; /* other walls than those of the snapshot */
    e->expected_walls = -1;
    walls_free(&e->walls);
    return walls_build(&e->walls, n, start, end, normal, previous, margin);
}

static void find_cell(engine *e, insect *one) {
    one->column = (int32_t)floor((one->x - e->low_x) / e->cell);
    one->row = (int32_t)floor((one->y - e->low_y) / e->cell);
    if (e->config.period > 0.0) return;
    if (one->column < 0) one->column = 0;
    if (one->row < 0) one->row = 0;
    if (one->column >= e->columns) one->column = e->columns - 1;
    if (one->row >= e->rows) one->row = e->rows - 1;
}

static int make_cells(engine *e, double width, double height) {
    double reach = most(e->config.detection, e->config.contact) * SEARCH_SLACK;
    e->cell = most(reach, sqrt(0.5 * width * height / e->n)); /* about one insect in two cells */
    while ((width / e->cell + 2.0) * (height / e->cell + 2.0) > 16.0 * e->n + 1024.0) e->cell *= 1.25;
    if (e->config.period > 0.0) {
        e->columns = e->rows = (int32_t)(e->config.period / e->cell);
        /* Of three columns each is next to each, and nobody would look again when another image of a pair comes near. */
        if (e->columns < 4) return -2;
        e->cell = e->config.period / e->columns;
    } else {
        e->columns = (int32_t)(width / e->cell) + 1;
        e->rows = (int32_t)(height / e->cell) + 1;
    }
    size_t count = (size_t)e->columns * (size_t)e->rows;
    e->cells = malloc(count * sizeof *e->cells);
    if (!e->cells) return -1;
    for (size_t k = 0; k < count; k++) e->cells[k] = -1;
    return 0;
}

int engine_start(engine *e, double low_x, double low_y, double high_x, double high_y) {
    e->low_x = low_x;
    e->low_y = low_y;
    int status = make_cells(e, high_x - low_x, high_y - low_y);
    if (status) return status;
    for (int32_t i = e->n - 1; i >= 0; i--) { /* the last one first: then cells list them in order, and links are added at the end */
        find_cell(e, &e->insect[i]);
        enter_cell(e, i);
        walk(e, i, 0.0, 0.0, 0.0, 0.0);
    }
    e->has_started = 1;
    for (int32_t i = 0; i < e->n; i++) visit_around(e, i, 0.0, find_company);
    for (int32_t i = 0; i < e->n; i++) visit_around(e, i, 0.0, evaluate);
    return e->has_failed ? -1 : 0;
}

/* Returns 1 where so much was done that what was told should be taken first, between two instants; 0 where `until_s` is reached. A step counts,
   and so does a look at a pair: in a crowd one step looks at everybody. */
int engine_advance(engine *e, double until_s, int64_t most_work) {
    int64_t last_work = engine_work(e) + most_work;
    double t = e->now;
    for (;;) {
        int32_t i = (int32_t)e->order[0].i;
        double own = e->order[0].t, joint = e->n_pairs ? e->pairs[0].t : INFINITY;
        if (!(least(own, joint) < until_s) || e->has_failed) break;
        if (engine_work(e) >= last_work && least(own, joint) > t) {
            e->now = t;
            return e->has_failed ? -1 : 1;
        }
        t = least(own, joint);
        e->n_steps++;
        if (own <= joint) {
            own_event(e, i);
            continue;
        }
        pair_event event = take_pair(e);
        if (e->insect[event.a].version == event.version_a && e->insect[event.b].version == event.version_b) pair_event_happens(e, &event);
    }
    e->now = until_s;
    return e->has_failed ? -1 : 0;
}

int engine_replace_walls(engine *e, int32_t n, const double *start, const double *end, const double *normal, const int32_t *previous, double margin,
                         const double *xy) {
    double t = e->now;
    for (int32_t i = 0; i < e->n; i++) close_leg(e, i, t);
    int status = engine_set_walls(e, n, start, end, normal, previous, margin);
    if (status) return status;
    for (int32_t i = 0; i < e->n; i++) {
        insect *one = &e->insect[i];
        one->x = xy[2 * i];
        one->y = xy[2 * i + 1];
        leave_cell(e, i);
        find_cell(e, one);
        enter_cell(e, i);
        one->touched = one->wall = one->passed_wall = one->next_wall = one->next_passed = -1;
        one->resume = WALK;
        one->version++;
    }
    e->has_started = 0; /* all get their legs before any looks at another */
    for (int32_t i = 0; i < e->n; i++) {
        insect *one = &e->insect[i];
        if (!is_walking(one)) continue;
        settle(e, one, t);
        one->normal_x = one->normal_y = 0.0;
        double left = one->activity == WALK ? (one->t_free - t) * e->config.speed : 0.0;
        walk(e, i, t, one->heading_x, one->heading_y, left);
    }
    e->has_started = 1;
    for (int32_t i = 0; i < e->n; i++) { /* those who were pushed out of each other's cells are found by their links alone */
        for (int32_t k = e->insect[i].near.count - 1; k >= 0; k--) find_company(e, i, e->insect[i].near.at[k].other, t);
        for (int32_t k = e->insect[i].close.count - 1; k >= 0; k--) find_company(e, i, e->insect[i].close.at[k].other, t);
    }
    for (int32_t i = 0; i < e->n; i++) visit_around(e, i, t, find_company);
    for (int32_t i = 0; i < e->n; i++) visit_around(e, i, t, evaluate);
    return e->has_failed ? -1 : 0;
}

int engine_stop(engine *e, int32_t row, int32_t cause) {
    insect *one = &e->insect[row];
    settle(e, one, e->now);
    one->is_held = 1;
    tell_mode(e, row, e->now, 1, cause);
    if (one->activity != STUCK && one->activity != DEAD) halt(e, row, e->now, HELD);
    engine_follow_walls(e, row, 0);
    return e->has_failed ? -1 : 0;
}

/* Let an insect keep to the walls that it meets from now on, or not. One that walks along a wall by command alone departs when it need not. */
int engine_follow_walls(engine *e, int32_t row, int32_t follows) {
    insect *one = &e->insect[row];
    if (one->follows_walls == (follows != 0)) return 0;
    one->follows_walls = follows != 0;
    if (law_of(e, one) == LAW_FOLLOW) return 0;
    if (one->resume == FOLLOW) one->resume = WALK;
    if (one->activity == FOLLOW) {
        settle(e, one, e->now);
        depart(e, row, e->now);
    }
    return e->has_failed ? -1 : 0;
}

/* Returns 1 where the insect walks now, 0 where it cannot. */
int engine_go(engine *e, int32_t row, int32_t cause) {
    insect *one = &e->insect[row];
    settle(e, one, e->now);
    one->is_held = 0;
    if (one->activity == STUCK || one->activity == DEAD) {
        if (one->cause != 0) tell_mode(e, row, e->now, 1, 0);
        return 0;
    }
    close_leg(e, row, e->now);
    tell_mode(e, row, e->now, 0, cause);
    one->heading_x = one->heading_y = 0.0;
    one->normal_x = one->normal_y = 0.0;
    one->activity = WALK;
    walk(e, row, e->now, 0.0, 0.0, 0.0);
    return e->has_failed ? -1 : 1;
}

/* Turn by an angle and go straight on for a distance (0: as far as a leg is drawn). Returns 1 where the insect moved. */
int engine_turn(engine *e, int32_t row, double turns, double distance) {
    insect *one = &e->insect[row];
    double cosine, sine, dx, dy;
    settle(e, one, e->now);
    if (one->activity == STUCK || one->activity == DEAD) return 0;
    if (one->heading_x == 0.0 && one->heading_y == 0.0) draws_circle(draw_uniform(e, one, DIRECTION, one->leg_number), &one->heading_x, &one->heading_y);
    draws_circle(turns, &cosine, &sine);
    rotate(one->heading_x, one->heading_y, cosine, sine, &dx, &dy);
    one->heading_x = dx;
    one->heading_y = dy;
    if (one->activity == HELD) return 0;
    close_leg(e, row, e->now);
    if (one->activity == RESTING) tell_mode(e, row, e->now, 0, 1);
    one->normal_x = one->normal_y = 0.0;
    one->activity = WALK;
    walk(e, row, e->now, dx, dy, distance);
    return e->has_failed ? -1 : 1;
}

int engine_silence(engine *e, int32_t row) {
    if (!e->insect[row].is_silent) fall_silent(e, row, e->now);
    return e->has_failed ? -1 : 0;
}

void engine_modes(const engine *e, int32_t *mode, int32_t *cause) {
    for (int32_t i = 0; i < e->n; i++) {
        mode[i] = !is_walking(&e->insect[i]);
        cause[i] = e->insect[i].cause;
    }
}

void engine_current_legs(const engine *e, engine_leg *legs) {
    for (int32_t i = 0; i < e->n; i++) {
        const insect *one = &e->insect[i];
        legs[i] = (engine_leg){one->t0, one->t_end, one->x, one->y, one->vx, one->vy, i};
    }
}

int64_t engine_take_events(engine *e, const engine_event **events) {
    int64_t count = e->n_events;
    *events = e->events;
    e->n_events = 0;
    return count;
}

int64_t engine_take_legs(engine *e, const engine_leg **legs) {
    int64_t count = e->n_legs;
    *legs = e->legs;
    e->n_legs = 0;
    return count;
}

int64_t engine_open(const engine *e, engine_event *found, int64_t room) {
    int64_t count = 0;
    for (int32_t i = 0; i < e->n; i++)
        for (int32_t k = 0; k < e->insect[i].near.count; k++) {
            const link *one = &e->insect[i].near.at[k];
            if (one->other < i || !one->is_clear) continue;
            if (count < room) found[count] = (engine_event){one->met_s, one->met_s, EVENT_BEGIN, i, one->other, 0};
            count++;
        }
    return count;
}

int64_t engine_steps(const engine *e) { return e->n_steps; }

int64_t engine_work(const engine *e) { return e->n_steps + e->n_looks; }

double engine_now(const engine *e) { return e->now; }
