/* What happens: events of one insect, and events between two. */
#include "state.h"

/* ---- an insect's own events ---- */

void halt(engine *e, int32_t i, double t, int activity) {
    insect *one = &e->insect[i];
    close_leg(e, i, t);
    if (is_walking(one)) one->resume = one->activity;
    one->activity = activity;
    stand(e, i, t, INFINITY);
}

static void end_leg(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    close_leg(e, i, t);
    if (one->activity == FOLLOW) {
        one->wall = one->next_wall;
        one->sense = one->next_sense;
        one->passed_wall = one->next_passed;
        follow(e, i, t);
    } else if (law_of(e, one) == LAW_FOLLOW && one->touched >= 0) {
        meet_wall(e, i, t);
    } else {
        walk(e, i, t, 0.0, 0.0, 0.0);
    }
}

static void cross_cell(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    double left = e->low_x + one->column * e->cell, bottom = e->low_y + one->row * e->cell;
    double across = crossing(t, one->t0, one->x, one->vx, left, left + e->cell), up = crossing(t, one->t0, one->y, one->vy, bottom, bottom + e->cell);
    int32_t column = one->column, row = one->row;
    if (across <= up)
        column += one->vx > 0.0 ? 1 : -1;
    else
        row += one->vy > 0.0 ? 1 : -1;
    if (e->config.period == 0.0 && cell_of(e, column, row) < 0) { /* rounding at the rim of the arena: the leg is about to end */
        one->t_own = INFINITY;
        consider(one, one->t_end, OWN_LEG_END);
        sift(e, i);
        return;
    }
    leave_cell(e, i);
    one->column = column;
    one->row = row;
    enter_cell(e, i);
    for (int32_t k = -1; k <= 1; k++) {
        if (across <= up)
            visit_cell(e, i, column + (one->vx > 0.0 ? 1 : -1), row + k, t, evaluate);
        else
            visit_cell(e, i, column + k, row + (one->vy > 0.0 ? 1 : -1), t, evaluate);
    }
    schedule(e, i, t);
}

void fall_silent(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    while (one->near.count) {
        link last = one->near.at[one->near.count - 1];
        int32_t a = i < last.other ? i : last.other, b = i < last.other ? last.other : i;
        if (last.is_clear) tell_end(e, a, b, last.met_s, t);
        drop_link(&e->insect[last.other].near, i);
        drop_link(&one->near, last.other);
    }
    one->is_silent = 1;
    tell(e, (engine_event){t, 0.0, EVENT_SILENCED, i, -1, 0});
    schedule(e, i, t);
}

void depart(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    const engine_config *c = &e->config;
    const wall *mine = &e->walls.wall[one->wall];
    double angle = c->departure_median, cosine, sine;
    close_leg(e, i, t);
    for (uint64_t k = 0; k < 8; k++) { /* angles beyond a half turn lead into the wall: drawn again */
        uint64_t index = 8 * one->n_bouts + k;
        double normal = draws_normal(draws_word(c->seed, one->id, DEPART_1, index), draws_word(c->seed, one->id, DEPART_2, index));
        double drawn = c->departure_median * draws_exp(c->departure_log_sd * normal);
        if (drawn < 0.5 * DRAWS_TWO_PI) {
            angle = drawn;
            break;
        }
    }
    draws_circle(angle / DRAWS_TWO_PI, &cosine, &sine);
    double dx = one->heading_x * cosine + mine->normal_x * sine, dy = one->heading_y * cosine + mine->normal_y * sine;
    double length = sqrt(dx * dx + dy * dy);
    one->normal_x = mine->normal_x;
    one->normal_y = mine->normal_y;
    walk(e, i, t, dx / length, dy / length, 0.0);
}

static void rest(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    int is_long = draw_uniform(e, one, REST_KIND, one->n_stops) < e->config.share_long;
    one->rest_left = (is_long ? e->config.rest_long : e->config.rest_short) * draw_exponential(e, one, REST, one->n_stops);
    one->n_stops++;
    one->stop_left = draw_exponential(e, one, STOP, one->n_stops);
    tell_mode(e, i, t, 1, 0);
    halt(e, i, t, RESTING);
}

static void come_to_grief(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    one->rest_left = e->config.mishap_rest * draw_exponential(e, one, MISHAP_REST, one->n_mishaps);
    one->n_mishaps++;
    one->mishap_left = draw_exponential(e, one, MISHAP, one->n_mishaps);
    tell_mode(e, i, t, 1, 0);
    halt(e, i, t, STUCK);
}

/* A rest or a mishap is over. */
static void get_up(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    settle(e, one, t);
    if (one->is_held) {
        one->activity = HELD;
        schedule(e, i, t);
        return;
    }
    close_leg(e, i, t);
    tell_mode(e, i, t, 0, 0);
    resume(e, i, t);
}

static void die(engine *e, int32_t i, double t) {
    insect *one = &e->insect[i];
    if (is_walking(one)) tell_mode(e, i, t, 1, 0);
    halt(e, i, t, DEAD);
}

void own_event(engine *e, int32_t i) {
    insect *one = &e->insect[i];
    double t = one->t_own;
    if (one->own_kind != OWN_CROSS) settle(e, one, t); /* where the cells lie must not show, not even in the last bit */
    switch (one->own_kind) {
        case OWN_LEG_END: end_leg(e, i, t); break;
        case OWN_CROSS: cross_cell(e, i, t); break;
        case OWN_STOP: rest(e, i, t); break;
        case OWN_REST_END: get_up(e, i, t); break;
        case OWN_EXIT: depart(e, i, t); break;
        case OWN_MISHAP: come_to_grief(e, i, t); break;
        case OWN_DEATH: die(e, i, t); break;
        default: fall_silent(e, i, t);
    }
}

/* ---- events of pairs ---- */

static void come_near(engine *e, int32_t a, int32_t b, double t) {
    if (find_link(&e->insect[a].near, b) || e->insect[a].is_silent || e->insect[b].is_silent) return;
    link mine = {t, b, 0}, theirs = {t, a, 0};
    add_link(e, &e->insect[a].near, mine);
    add_link(e, &e->insect[b].near, theirs);
    if (!e->has_failed) {
        passage p = see_passage(e, &e->insect[a], &e->insect[b], t);
        expect_encounter(e, a, b, &p, t); /* tells of the beginning as soon as they see each other */
    }
}

static void go_apart(engine *e, int32_t a, int32_t b, double t) {
    link *mine = find_link(&e->insect[a].near, b);
    if (!mine) return;
    if (mine->is_clear) tell_end(e, a, b, mine->met_s, t);
    drop_link(&e->insect[a].near, b);
    drop_link(&e->insect[b].near, a);
}

static void count_neighbour(engine *e, int32_t i, int change, double t) {
    settle(e, &e->insect[i], t);
    e->insect[i].neighbours += change;
    schedule(e, i, t);
}

static void recoil(engine *e, int32_t i, int32_t from, double t) {
    insect *one = &e->insect[i];
    if (!is_walking(one)) return;
    settle(e, one, t);
    close_leg(e, i, t);
    if (one->activity == FOLLOW) {
        one->sense = -one->sense;
        one->passed_wall = -1;
        follow(e, i, t);
        return;
    }
    double x, y;
    place_at(&e->insect[from], t, &x, &y);
    double away_x = one->x - x, away_y = one->y - y;
    if (e->config.period > 0.0) {
        away_x -= wrap(away_x, e->config.period);
        away_y -= wrap(away_y, e->config.period);
    }
    double distance = sqrt(away_x * away_x + away_y * away_y);
    if (distance > 0.0) {
        one->normal_x = away_x / distance;
        one->normal_y = away_y / distance;
    }
    double dx, dy;
    draws_circle(0.5 * draw_uniform(e, one, DIRECTION, one->leg_number) - 0.25, &dx, &dy);
    rotate(one->normal_x, one->normal_y, dx, dy, &away_x, &away_y);
    walk(e, i, t, away_x, away_y, 0.0);
}

static void help_up(engine *e, int32_t i, int32_t by, double t) {
    insect *one = &e->insect[i];
    if (one->activity != STUCK || !is_walking(&e->insect[by])) return;
    if (draw_uniform(e, one, RESCUE, one->n_rescues++) < e->config.rescue) get_up(e, i, t);
}

/* Link two insects that touch; returns whether they are new to each other, and in sight. */
static int join_bodies(engine *e, int32_t a, int32_t b, double t) {
    if (find_link(&e->insect[a].close, b)) return 0;
    passage p = see_passage(e, &e->insect[a], &e->insect[b], t);
    double begin, end, until;
    double limit = solve(&p, e->config.contact, &begin, &end) ? least(end, p.stop) : p.stop;
    int is_clear = limit > t ? is_in_sight(e, &e->insect[a], &e->insect[b], &p, t, limit, &until) : 1;
    link mine = {t, b, is_clear}, theirs = {t, a, is_clear};
    add_link(e, &e->insect[a].close, mine);
    add_link(e, &e->insect[b].close, theirs);
    if (e->has_failed) return 0;
    expect_contact(e, a, b, &p, t);
    if (!is_clear) return 0;
    count_neighbour(e, a, 1, t);
    count_neighbour(e, b, 1, t);
    return 1;
}

static void touch_bodies(engine *e, int32_t a, int32_t b, double t) {
    if (!join_bodies(e, a, b, t)) return;
    help_up(e, a, b, t);
    help_up(e, b, a, t);
    if (!e->config.contact_turns) return;
    recoil(e, a, b, t);
    recoil(e, b, a, t);
}

static void part_bodies(engine *e, int32_t a, int32_t b, double t) {
    link *mine = find_link(&e->insect[a].close, b);
    if (!mine) return;
    int was_clear = mine->is_clear;
    drop_link(&e->insect[a].close, b);
    drop_link(&e->insect[b].close, a);
    if (!was_clear) return;
    count_neighbour(e, a, -1, t);
    count_neighbour(e, b, -1, t);
}

void pair_event_happens(engine *e, const pair_event *event) {
    int32_t a = event->a, b = event->b;
    passage p;
    switch (event->kind) {
        case PAIR_END: go_apart(e, a, b, event->t); break;
        case PAIR_BEGIN: come_near(e, a, b, event->t); break;
        case PAIR_PART: part_bodies(e, a, b, event->t); break;
        case PAIR_TOUCH: touch_bodies(e, a, b, event->t); break;
        default:
            p = see_passage(e, &e->insect[a], &e->insect[b], event->t);
            if (find_link(&e->insect[a].near, b)) expect_encounter(e, a, b, &p, event->t);
    }
}

/* Where insects are put down, not walked to: note who is within reach of whom. */
void find_company(engine *e, int32_t i, int32_t j, double t) {
    int32_t a = i < j ? i : j, b = i < j ? j : i;
    double ax, ay, bx, by;
    place_at(&e->insect[a], t, &ax, &ay);
    place_at(&e->insect[b], t, &bx, &by);
    double x = ax - bx, y = ay - by;
    if (e->config.period > 0.0) {
        x -= wrap(x, e->config.period);
        y -= wrap(y, e->config.period);
    }
    double square = x * x + y * y;
    if (!e->insect[a].is_silent && !e->insect[b].is_silent) {
        if (square <= e->config.detection * e->config.detection)
            come_near(e, a, b, t);
        else
            go_apart(e, a, b, t);
    }
    if (e->config.contact > 0.0) {
        if (square > e->config.contact * e->config.contact)
            part_bodies(e, a, b, t);
        else
            join_bodies(e, a, b, t); /* they did not run into each other, and so do not recoil */
    }
}
