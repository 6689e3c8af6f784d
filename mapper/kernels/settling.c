/* Settle the tracks of biobots in the plane: least squares made again and again with weights that let go of what does not fit.

   A link says how long its biobot walked between two places: they are that far apart or less. Where it is followed by another of the same
   biobot, the velocity is mostly the same before and after. Every place is drawn to where it began, more or less. All sums are made in the
   order of the links, so that the plain way rounds them alike. */
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Beyond so many times its expected error, a residual is let go of: a turn, and a way that was not straight. */
static const double TURN_LIMIT = 3, LENGTH_LIMIT = 2;
static const double NO_LENGTH = 1e-9;

typedef struct {
  int32_t n;
  int64_t n_links;
  const int32_t *from, *to, *before;
  const double *time, *pull;
  double *per_time;  /* [n_links] 1 / time */
  double *tension;   /* [n_links] weight of the length */
  double *stiffness; /* [n_links] weight of the change of velocity where this link begins */
  double *diagonal;  /* [n] */
} net;

/* Weigh every residual by how well it fits, and set up the equations: their diagonal and their right side. */
static void weigh(const net *g, const double *start, double blur, double swerve, double drift, const double *xy, double *right) {
  for (int32_t i = 0; i < g->n; i++) {
    g->diagonal[i] = g->pull[i];
    right[2 * i] = g->pull[i] * start[2 * i];
    right[2 * i + 1] = g->pull[i] * start[2 * i + 1];
  }
  double blur2 = blur * blur, swerve2 = swerve * swerve;
  for (int64_t e = 0; e < g->n_links; e++) {
    int32_t a = g->from[e], b = g->to[e], before = g->before[e];
    double dx = xy[2 * b] - xy[2 * a], dy = xy[2 * b + 1] - xy[2 * a + 1], time = g->time[e];
    double length = sqrt(dx * dx + dy * dy) + NO_LENGTH * blur, excess = length - time;
    double lag = drift * time, weight = 1 / blur2;
    if (excess <= 0) {
      double variance = blur2 + lag * lag;
      weight = 1 / (variance + excess * excess / (LENGTH_LIMIT * LENGTH_LIMIT));
    }
    double force = weight * time / length, fx = force * dx, fy = force * dy;
    g->tension[e] = weight;
    g->diagonal[b] += weight;
    g->diagonal[a] += weight;
    right[2 * b] += fx;
    right[2 * b + 1] += fy;
    right[2 * a] -= fx;
    right[2 * a + 1] -= fy;
    g->stiffness[e] = 0;
    if (before < 0) continue;
    int32_t o = g->from[before];
    double f = g->per_time[before], s = g->per_time[e], m = f + s;
    double ax = s * xy[2 * b] + f * xy[2 * o] - m * xy[2 * a], ay = s * xy[2 * b + 1] + f * xy[2 * o + 1] - m * xy[2 * a + 1];
    double variance = blur2 * (f * f + s * s + m * m) + swerve2;
    double stiff = 1 / (variance + (ax * ax + ay * ay) / (TURN_LIMIT * TURN_LIMIT));
    g->stiffness[e] = stiff;
    g->diagonal[b] += stiff * s * s;
    g->diagonal[o] += stiff * f * f;
    g->diagonal[a] += stiff * m * m;
  }
}

/* The left side of the equations for places xy. */
static void apply(const net *g, const double *xy, double *left) {
  for (int32_t i = 0; i < g->n; i++) {
    left[2 * i] = g->pull[i] * xy[2 * i];
    left[2 * i + 1] = g->pull[i] * xy[2 * i + 1];
  }
  for (int64_t e = 0; e < g->n_links; e++) {
    int32_t a = g->from[e], b = g->to[e], before = g->before[e];
    double weight = g->tension[e], dx = weight * (xy[2 * b] - xy[2 * a]), dy = weight * (xy[2 * b + 1] - xy[2 * a + 1]);
    left[2 * b] += dx;
    left[2 * b + 1] += dy;
    left[2 * a] -= dx;
    left[2 * a + 1] -= dy;
    if (before < 0) continue;
    int32_t o = g->from[before];
    double stiff = g->stiffness[e], f = g->per_time[before], s = g->per_time[e], m = f + s;
    double ax = stiff * (s * xy[2 * b] + f * xy[2 * o] - m * xy[2 * a]);
    double ay = stiff * (s * xy[2 * b + 1] + f * xy[2 * o + 1] - m * xy[2 * a + 1]);
    left[2 * b] += s * ax;
    left[2 * b + 1] += s * ay;
    left[2 * o] += f * ax;
    left[2 * o + 1] += f * ay;
    left[2 * a] -= m * ax;
    left[2 * a + 1] -= m * ay;
  }
}

/* Sums over the places of products of both coordinates; even and odd places are summed apart. */
static void multiply(const double *one, const double *other, int32_t n, double sums[2]) {
  double lane[4] = {0, 0, 0, 0};
  int64_t size = 2 * (int64_t)n, whole = size / 4 * 4;
  for (int64_t i = 0; i < whole; i += 4)
    for (int32_t j = 0; j < 4; j++) lane[j] += one[i + j] * other[i + j];
  for (int64_t i = whole; i < size; i++) lane[i - whole] += one[i] * other[i];
  sums[0] = lane[0] + lane[2];
  sums[1] = lane[1] + lane[3];
}

/* Some steps of conjugate gradients from where the places are, both coordinates side by side. */
static void solve(const net *g, const double *right, int32_t steps, double *xy, double *residual, double *way, double *spare) {
  double before[2], now[2], along[2], step[2];
  apply(g, xy, spare);
  for (int64_t i = 0; i < 2 * (int64_t)g->n; i++) {
    residual[i] = right[i] - spare[i];
    way[i] = residual[i] / g->diagonal[i / 2];
  }
  multiply(residual, way, g->n, before);
  for (int32_t round = 0; round < steps; round++) {
    apply(g, way, spare);
    multiply(way, spare, g->n, along);
    for (int32_t k = 0; k < 2; k++) step[k] = along[k] > 0 ? before[k] / along[k] : 0;
    for (int64_t i = 0; i < 2 * (int64_t)g->n; i++) {
      xy[i] += step[i % 2] * way[i];
      residual[i] -= step[i % 2] * spare[i];
      spare[i] = residual[i] / g->diagonal[i / 2];
    }
    multiply(residual, spare, g->n, now);
    for (int32_t k = 0; k < 2; k++) step[k] = before[k] > 0 ? now[k] / before[k] : 0;
    for (int64_t i = 0; i < 2 * (int64_t)g->n; i++) way[i] = spare[i] + step[i % 2] * way[i];
    before[0] = now[0];
    before[1] = now[1];
  }
}

/* Move n places (xy, both coordinates of one side by side) to where their links want them.

   `pull` [n] is how strongly each is drawn to where it starts; `blur` the error of a place, `drift` that of a length by its time, `swerve`
   the change of velocity that needs no turn. Times and lengths are in one unit: speeds are 1. */
KERNEL int settle_tracks(int32_t n, int64_t n_links, const int32_t *from, const int32_t *to, const int32_t *before, const double *time,
                         const double *pull, const double *start, double blur, double swerve, double drift, int32_t rounds,
                         int32_t steps, double *xy) {
  size_t places = 2 * (size_t)n + 1, links = (size_t)n_links + 1;
  double *room = malloc((4 * places + (size_t)n + 3 * links) * sizeof *room);
  if (!room) return NO_MEMORY;
  double *right = room, *residual = right + places, *way = residual + places, *spare = way + places;
  net g = {n, n_links, from, to, before, time, pull, spare + places, spare + places + links, spare + places + 2 * links,
           spare + places + 3 * links};
  for (int64_t e = 0; e < n_links; e++) g.per_time[e] = 1 / (time[e] > blur ? time[e] : blur);
  memcpy(xy, start, 2 * (size_t)n * sizeof *xy);
  for (int32_t round = 0; round < rounds; round++) {
    weigh(&g, start, blur, swerve, drift, xy, right);
    solve(&g, right, steps, xy, residual, way, spare);
  }
  free(room);
  return 0;
}
