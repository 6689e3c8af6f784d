/* Two insects on their present legs: when they come near, see each other and part; and the grid of cells that finds who is near. */
#include "state.h"

/* ---- pairs ---- */

/* The place of another in a list, or where it would be: lists are in order, for in a crowd everybody is in everybody's. */
static int32_t place_of(const links *all, int32_t other) {
    int32_t low = 0, high = all->count;
    while (low < high) {
        int32_t middle = low + (high - low) / 2;
        if (all->at[middle].other < other)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

link *find_link(links *all, int32_t other) {
    int32_t place = place_of(all, other);
    return place < all->count && all->at[place].other == other ? &all->at[place] : NULL;
}

link *add_link(engine *e, links *all, link one) {
    if (all->count == all->room) {
        int32_t wanted = all->room ? 2 * all->room : 4;
        link *larger = realloc(all->at, (size_t)wanted * sizeof *larger);
        if (!larger) {
            e->has_failed = 1;
            return NULL;
        }
        all->at = larger;
        all->room = wanted;
    }
    int32_t place = place_of(all, one.other);
    memmove(&all->at[place + 1], &all->at[place], (size_t)(all->count - place) * sizeof *all->at);
    all->at[place] = one;
    all->count++;
    return &all->at[place];
}

void drop_link(links *all, int32_t other) {
    link *found = find_link(all, other);
    if (!found) return;
    all->count--;
    memmove(found, found + 1, (size_t)(&all->at[all->count] - found) * sizeof *found);
}

double wrap(double distance, double period) { return period * floor(distance / period + 0.5); }

passage see_passage(const engine *e, const insect *a, const insect *b, double t) {
    passage p;
    p.t_ref = most(a->t0, b->t0);
    p.stop = least(a->t_end, b->t_end);
    p.x = (a->x + a->vx * (p.t_ref - a->t0)) - (b->x + b->vx * (p.t_ref - b->t0));
    p.y = (a->y + a->vy * (p.t_ref - a->t0)) - (b->y + b->vy * (p.t_ref - b->t0));
    p.vx = a->vx - b->vx;
    p.vy = a->vy - b->vy;
    if (e->config.period > 0.0) { /* the image that is nearest now */
        p.x -= wrap(p.x + p.vx * (t - p.t_ref), e->config.period);
        p.y -= wrap(p.y + p.vy * (t - p.t_ref), e->config.period);
    }
    p.speed_squared = p.vx * p.vx + p.vy * p.vy;
    p.miss = p.x * p.vy - p.y * p.vx;
    p.nearest = p.speed_squared > 0.0 ? -(p.x * p.vx + p.y * p.vy) / p.speed_squared : 0.0;
    return p;
}

/* When the distance comes to be, and ceases to be, within a radius: by the distance of closest approach, which does not cancel. */
int solve(const passage *p, double radius, double *begin, double *end) {
    double inside = radius * radius * p->speed_squared - p->miss * p->miss;
    if (!(p->speed_squared > 0.0) || !(inside > 0.0)) return 0;
    double half = sqrt(inside) / p->speed_squared;
    *begin = p->t_ref + (p->nearest - half);
    *end = p->t_ref + (p->nearest + half);
    if (*begin <= p->t_ref + TIME_ROUNDING * (1.0 + fabs(p->t_ref))) *begin = p->t_ref;
    if (*end >= p->stop * (1.0 - TIME_ROUNDING) - TIME_ROUNDING) *end = p->stop;
    return *begin < *end;
}

void place_at(const insect *one, double t, double *x, double *y) {
    *x = one->x + one->vx * (t - one->t0);
    *y = one->y + one->vy * (t - one->t0);
}

/* The instants when a corner is in line with both insects: two roots, nan where there is none. */
static void times_in_line(const insect *a, const insect *b, double t_ref, double corner_x, double corner_y, double root[2]) {
    double ax, ay, bx, by;
    place_at(a, t_ref, &ax, &ay);
    place_at(b, t_ref, &bx, &by);
    ax -= corner_x, ay -= corner_y, bx -= corner_x, by -= corner_y;
    /* cross(a + u tau, b + w tau) = 0 */
    double square = a->vx * b->vy - a->vy * b->vx;
    double linear = ax * b->vy - ay * b->vx + a->vx * by - a->vy * bx;
    double constant = ax * by - ay * bx;
    /* The sum that does not cancel gives one root, the product of the roots the other (square = 0: the one there is). */
    double q = -0.5 * (linear + copysign(sqrt(linear * linear - 4.0 * square * constant), linear));
    root[0] = t_ref + q / square;
    root[1] = t_ref + constant / q;
}

static int stands_between(const wall *one, double ax, double ay, double bx, double by) {
    /* Strictly on one side or not: a corner exactly in line belongs to one side for both walls that share it. */
    int start_left = (bx - ax) * (one->y - ay) - (by - ay) * (one->x - ax) >= 0.0;
    int end_left = (bx - ax) * (one->end_y - ay) - (by - ay) * (one->end_x - ax) >= 0.0;
    if (start_left == end_left) return 0;
    int a_before = (ax - one->x) * one->normal_x + (ay - one->y) * one->normal_y >= 0.0;
    int b_before = (bx - one->x) * one->normal_x + (by - one->y) * one->normal_y >= 0.0;
    return a_before != b_before;
}

/* Tell whether two insects see each other just after t, and until when (at least until `limit` where it is later) nothing changes that. */
int is_in_sight(engine *e, const insect *a, const insect *b, const passage *p, double t, double limit, double *until) {
    double last = isfinite(limit) ? limit : t, ax, ay, bx, by, later_ax, later_ay, later_bx, later_by;
    *until = INFINITY;
    if (e->walls.n == 0) return 1;
    place_at(a, t, &ax, &ay);
    place_at(b, t, &bx, &by);
    place_at(a, last, &later_ax, &later_ay);
    place_at(b, last, &later_bx, &later_by);
    double x_min = least(least(ax, bx), least(later_ax, later_bx)), x_max = most(most(ax, bx), most(later_ax, later_bx));
    double y_min = least(least(ay, by), least(later_ay, later_by)), y_max = most(most(ay, by), most(later_ay, later_by));
    int32_t count = walls_near(&e->walls, x_min, x_max, y_min, y_max, e->near_walls, e->room_near);
    if (count > e->room_near) {
        int32_t *larger = realloc(e->near_walls, (size_t)count * sizeof *larger);
        if (!larger) {
            e->has_failed = 1;
            return 1;
        }
        e->near_walls = larger;
        e->room_near = count;
        count = walls_near(&e->walls, x_min, x_max, y_min, y_max, e->near_walls, e->room_near);
    }
    for (int32_t k = 0; k < count; k++) {
        const wall *one = &e->walls.wall[e->near_walls[k]];
        double root[4];
        times_in_line(a, b, p->t_ref, one->x, one->y, root);
        times_in_line(a, b, p->t_ref, one->end_x, one->end_y, root + 2);
        for (int r = 0; r < 4; r++)
            if (root[r] > t && root[r] < *until) *until = root[r];
    }
    double middle = least(*until, limit);
    middle = isfinite(middle) ? 0.5 * (t + middle) : t;
    place_at(a, middle, &ax, &ay);
    place_at(b, middle, &bx, &by);
    for (int32_t k = 0; k < count; k++)
        if (stands_between(&e->walls.wall[e->near_walls[k]], ax, ay, bx, by)) return 0;
    return 1;
}

static void set_sight(engine *e, int32_t a, int32_t b, link *mine, int is_clear, double t) {
    if (mine->is_clear == is_clear) return;
    double met_s = mine->met_s;
    link *theirs = find_link(&e->insect[b].near, a);
    mine->is_clear = theirs->is_clear = is_clear;
    mine->met_s = theirs->met_s = t;
    if (is_clear)
        tell(e, (engine_event){t, t, EVENT_BEGIN, a, b, 0});
    else
        tell_end(e, a, b, met_s, t);
}

/* Find out what comes next between two insects (a < b) as to detection; t is now. */
void expect_encounter(engine *e, int32_t a, int32_t b, const passage *p, double t) {
    double begin, end;
    int meets = solve(p, e->config.detection, &begin, &end);
    link *mine = find_link(&e->insect[a].near, b);
    if (!mine) {
        if (!meets || !(p->t_ref + p->nearest > t) || !(begin < p->stop)) return;
        expect(e, most(begin, t), PAIR_BEGIN, a, b);
        return;
    }
    double leaves = p->speed_squared > 0.0 ? (meets ? most(end, t) : t) : INFINITY, until;
    double limit = least(leaves, p->stop);
    int is_clear = limit > t ? is_in_sight(e, &e->insect[a], &e->insect[b], p, t, limit, &until) : mine->is_clear;
    set_sight(e, a, b, mine, is_clear, t);
    if (limit > t && until < limit) expect(e, until, PAIR_SIGHT, a, b);
    if (leaves < p->stop) expect(e, leaves, PAIR_END, a, b);
}

void expect_contact(engine *e, int32_t a, int32_t b, const passage *p, double t) {
    double begin, end;
    int meets = solve(p, e->config.contact, &begin, &end);
    if (!find_link(&e->insect[a].close, b)) {
        if (meets && p->t_ref + p->nearest > t && begin < p->stop) expect(e, most(begin, t), PAIR_TOUCH, a, b);
        return;
    }
    double leaves = p->speed_squared > 0.0 ? (meets ? most(end, t) : t) : INFINITY;
    if (leaves < p->stop) expect(e, leaves, PAIR_PART, a, b);
}

void evaluate(engine *e, int32_t i, int32_t j, double t) {
    int32_t a = i < j ? i : j, b = i < j ? j : i;
    passage p = see_passage(e, &e->insect[a], &e->insect[b], t);
    e->n_looks++;
    if (!e->insect[a].is_silent && !e->insect[b].is_silent) expect_encounter(e, a, b, &p, t);
    if (e->config.contact > 0.0) expect_contact(e, a, b, &p, t);
}

int32_t cell_of(const engine *e, int32_t column, int32_t row) {
    if (e->config.period > 0.0) {
        column = (column % e->columns + e->columns) % e->columns;
        row = (row % e->rows + e->rows) % e->rows;
    } else if (column < 0 || column >= e->columns || row < 0 || row >= e->rows) {
        return -1;
    }
    return row * e->columns + column;
}

void leave_cell(engine *e, int32_t i) {
    insect *one = &e->insect[i];
    if (one->previous_in_cell >= 0)
        e->insect[one->previous_in_cell].next_in_cell = one->next_in_cell;
    else
        e->cells[one->cell] = one->next_in_cell;
    if (one->next_in_cell >= 0) e->insect[one->next_in_cell].previous_in_cell = one->previous_in_cell;
}

void enter_cell(engine *e, int32_t i) {
    insect *one = &e->insect[i];
    int32_t cell = cell_of(e, one->column, one->row);
    one->cell = cell;
    one->previous_in_cell = -1;
    one->next_in_cell = e->cells[cell];
    if (one->next_in_cell >= 0) e->insect[one->next_in_cell].previous_in_cell = i;
    e->cells[cell] = i;
}

void visit_cell(engine *e, int32_t i, int32_t column, int32_t row, double t, with_neighbour visit) {
    int32_t cell = cell_of(e, column, row);
    if (cell < 0) return;
    for (int32_t j = e->cells[cell]; j >= 0; j = e->insect[j].next_in_cell)
        if (j != i) visit(e, i, j, t);
}

void visit_around(engine *e, int32_t i, double t, with_neighbour visit) {
    for (int32_t row = e->insect[i].row - 1; row <= e->insect[i].row + 1; row++)
        for (int32_t column = e->insect[i].column - 1; column <= e->insect[i].column + 1; column++) visit_cell(e, i, column, row, t, visit);
}

/* Whenever an insect has got a new leg. */
void go_on(engine *e, int32_t i, double t) {
    e->insect[i].version++;
    if (e->has_started) visit_around(e, i, t, evaluate);
    schedule(e, i, t);
}
