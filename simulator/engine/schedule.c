/* What is told to the world, what comes next: buffers, the two heaps, and the hazards that strike without memory. */
#include "state.h"

/* ---- what is told ---- */

void tell(engine *e, engine_event event) {
    e->events = grow(e, e->events, &e->room_events, e->n_events + 1, sizeof *e->events);
    if (!e->has_failed) e->events[e->n_events++] = event;
}

void tell_mode(engine *e, int32_t i, double t, int is_still, int cause) {
    e->insect[i].cause = cause;
    tell(e, (engine_event){t, 0.0, EVENT_MODE, i, is_still, cause});
}

void tell_end(engine *e, int32_t a, int32_t b, double met_s, double t) {
    if (t > met_s) {
        tell(e, (engine_event){t, met_s, EVENT_END, a, b, 0});
        return;
    }
    for (int64_t k = e->n_events - 1; k >= 0; k--) { /* it lasted for no time: take back its beginning */
        engine_event *told = &e->events[k];
        if (told->kind == EVENT_BEGIN && told->first == a && told->second == b && told->t_s == t) {
            told->kind = -1;
            return;
        }
        if (told->t_s < t) return;
    }
}

void close_leg(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    if (t > one->t0) {
        e->legs = grow(e, e->legs, &e->room_legs, e->n_legs + 1, sizeof *e->legs);
        if (!e->has_failed) e->legs[e->n_legs++] = (engine_leg){one->t0, t, one->x, one->y, one->vx, one->vy, i};
        one->x = one->x + one->vx * (t - one->t0);
        one->y = one->y + one->vy * (t - one->t0);
    }
    one->t0 = t;
}

/* ---- heaps ---- */

static int own_before(const own_entry *one, const own_entry *other) { return one->t < other->t || (one->t == other->t && one->i < other->i); }

void sift(engine *e, int32_t i) {
    int32_t place = e->insect[i].place_in_heap;
    const own_entry mine = {e->insect[i].t_own, i};
    while (place > 0) {
        int32_t above = (place - 1) / 4;
        if (!own_before(&mine, &e->order[above])) break;
        e->order[place] = e->order[above];
        e->insect[e->order[place].i].place_in_heap = place;
        place = above;
    }
    for (;;) {
        int32_t child = 4 * place + 1, best = -1;
        for (int32_t k = child; k < child + 4 && k < e->n; k++)
            if (best < 0 || own_before(&e->order[k], &e->order[best])) best = k;
        if (best < 0 || !own_before(&e->order[best], &mine)) break;
        e->order[place] = e->order[best];
        e->insect[e->order[place].i].place_in_heap = place;
        place = best;
    }
    e->order[place] = mine;
    e->insect[i].place_in_heap = place;
}

static int pair_before(const pair_event *one, const pair_event *other) {
    if (one->t != other->t) return one->t < other->t;
    if (one->kind != other->kind) return one->kind < other->kind;
    if (one->a != other->a) return one->a < other->a;
    return one->b < other->b;
}

void expect(engine *e, double t, int kind, int32_t a, int32_t b) {
    e->pairs = grow(e, e->pairs, &e->room_pairs, e->n_pairs + 1, sizeof *e->pairs);
    if (e->has_failed) return;
    pair_event added = {t, kind, a, b, e->insect[a].version, e->insect[b].version, 0};
    int64_t place = e->n_pairs++;
    while (place > 0) {
        int64_t above = (place - 1) / 4;
        if (!pair_before(&added, &e->pairs[above])) break;
        e->pairs[place] = e->pairs[above];
        place = above;
    }
    e->pairs[place] = added;
}

pair_event take_pair(engine *e) {
    pair_event top = e->pairs[0], last = e->pairs[--e->n_pairs];
    int64_t place = 0;
    for (;;) {
        int64_t child = 4 * place + 1, best = -1;
        for (int64_t k = child; k < child + 4 && k < e->n_pairs; k++)
            if (best < 0 || pair_before(&e->pairs[k], &e->pairs[best])) best = k;
        if (best < 0 || !pair_before(&e->pairs[best], &last)) break;
        e->pairs[place] = e->pairs[best];
        place = best;
    }
    e->pairs[place] = last;
    return top;
}

/* ---- hazards ---- */

static double stop_hazard(const engine *e, const insect *one) {
    double hazard = one->activity == WALK ? e->config.stop_open : one->activity == FOLLOW ? e->config.stop_wall : 0.0;
    return hazard * (1.0 + e->config.social_stop * one->neighbours);
}

static double rest_pace(const engine *e, const insect *one) {
    if (one->activity == RESTING) return 1.0 / (1.0 + e->config.social_rest * one->neighbours);
    return one->activity == STUCK ? 1.0 : 0.0;
}

int is_walking(const insect *one) { return one->activity == WALK || one->activity == FOLLOW; }

/* Use up the hazards for the time since they were last settled: to be called before anything they depend on changes. */
void settle(engine *e, insect *one, double t) {
    double passed = t - one->t_settled;
    one->t_settled = t;
    if (!(passed > 0.0) || one->activity == DEAD) return;
    one->death_left -= e->config.death * passed;
    one->rest_left -= rest_pace(e, one) * passed;
    if (!is_walking(one)) return;
    one->stop_left -= stop_hazard(e, one) * passed;
    one->mishap_left -= e->config.mishap * passed;
    if (one->activity == FOLLOW) one->exit_left -= e->config.exit_wall * passed;
}

void consider(insect *one, double t, int kind) {
    if (t < one->t_own) {
        one->t_own = t;
        one->own_kind = kind;
    }
}

static void consider_hazard(insect *one, double left, double hazard, int kind) {
    if (hazard > 0.0) consider(one, one->t_settled + most(left, 0.0) / hazard, kind);
}

double crossing(double t, double t0, double place, double velocity, double low, double high) {
    if (velocity == 0.0) return INFINITY;
    return most(t, t0 + ((velocity > 0.0 ? high : low) - place) / velocity);
}

/* Find an insect's next own event. Hazards count from when they were last settled. */
void schedule(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    one->t_own = INFINITY;
    one->own_kind = OWN_LEG_END;
    consider(one, one->t_end, OWN_LEG_END);
    if (!one->is_silent) consider(one, most(one->silent_from, t), OWN_SILENCE);
    if (one->activity != DEAD) {
        consider_hazard(one, one->death_left, e->config.death, OWN_DEATH);
        consider_hazard(one, one->rest_left, rest_pace(e, one), OWN_REST_END);
        if (is_walking(one)) {
            consider_hazard(one, one->stop_left, stop_hazard(e, one), OWN_STOP);
            consider_hazard(one, one->mishap_left, e->config.mishap, OWN_MISHAP);
            if (one->activity == FOLLOW) consider_hazard(one, one->exit_left, e->config.exit_wall, OWN_EXIT);
            double left = e->low_x + one->column * e->cell, bottom = e->low_y + one->row * e->cell;
            consider(one, crossing(t, one->t0, one->x, one->vx, left, left + e->cell), OWN_CROSS);
            consider(one, crossing(t, one->t0, one->y, one->vy, bottom, bottom + e->cell), OWN_CROSS);
        }
    }
    sift(e, i);
}
