/* Shortest times from many vertices at once, by sweeps over the links in the order of time and back.

   A path runs along time, turns, runs back, and so on; one pass forward and one backward settle all paths with two more turns. Between passes the
   table between the sources is closed, so a path over several landmarks does not cost several passes. A link whose source has not changed since it
   was last looked at is passed over. Where paths turn very often, a search from all that changed last ends it, so that no graph costs more
   than searches would. What comes out is the fixpoint of the shortest-path equations, which is unique. */
#include "kernels.h"
#include "queue.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Numbers in a vector: a row is padded to a multiple. And passes before a search takes over; walks of insects need some twenty. */
enum { WHOLE = 4, MOST_PASSES = 64 };

typedef double vector __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t mask __attribute__((vector_size(32)));

/* Lower a row to another one plus a time; say whether anything fell. Without branches: every second look changes something, in no order. */
static inline __attribute__((always_inline)) int relax(double *row, const double *other, double time, int32_t stride) {
  mask fell = {0};
  for (int32_t j = 0; j < stride; j += WHOLE) {
    vector through = *(const vector *)(other + j) + time, old = *(const vector *)(row + j);
    mask lower = through < old;
    fell |= lower;
    *(vector *)(row + j) = (vector)((lower & (mask)through) | (~lower & (mask)old));
  }
  return (fell[0] | fell[1] | fell[2] | fell[3]) != 0;
}

TWICE static int pass_once(int64_t n_links, const int32_t *from, const int32_t *to, const double *time, double *table, int32_t stride,
                           int32_t *changed, int32_t pass) {
  int is_forward = pass % 2, fell = 0;
  const int32_t *source = is_forward ? from : to, *target = is_forward ? to : from;
  for (int64_t k = 0; k < n_links; k++) {
    int64_t i = is_forward ? k : n_links - 1 - k;
    /* Its last look was two passes ago; a hub may have changed after that look in the same pass. */
    if (changed[source[i]] < pass - 2) continue;
    int any = relax(table + (int64_t)target[i] * stride, table + (int64_t)source[i] * stride, time[i], stride);
    changed[target[i]] = any ? pass : changed[target[i]];
    fell |= any;
  }
  return fell;
}

/* Floyd and Warshall among the sources' own rows. */
TWICE static void close_table(double *table, int32_t stride, const int32_t *sources, int32_t n_sources, int32_t *changed, int32_t pass) {
  for (int32_t k = 0; k < n_sources; k++)
    for (int32_t i = 0; i < n_sources; i++) {
      double *row = table + (int64_t)sources[i] * stride;
      if (i != k && row[k] < INFINITY && relax(row, table + (int64_t)sources[k] * stride, row[k], stride)) changed[sources[i]] = pass;
    }
}

/* Which links touch each vertex: those of v are edge[start[v]] .. edge[start[v + 1] - 1]. */
static void list_links(int64_t n_links, const int32_t *from, const int32_t *to, int32_t n_vertices, int64_t *start, int64_t *edge) {
  memset(start, 0, ((size_t)n_vertices + 2) * sizeof *start);
  for (int64_t i = 0; i < n_links; i++) {
    start[from[i] + 2]++;
    start[to[i] + 2]++;
  }
  for (int32_t v = 0; v < n_vertices; v++) start[v + 2] += start[v + 1];
  for (int64_t i = 0; i < n_links; i++) {
    edge[start[from[i] + 1]++] = i;
    edge[start[to[i] + 1]++] = i;
  }
}

/* Search on from the vertices that changed in the last two passes: elsewhere the equations hold. One lane after the other. */
static int search_on(int64_t n_links, const int32_t *from, const int32_t *to, const double *time, int32_t n_vertices, double *table,
                     int32_t stride, int32_t n_sources, const int32_t *changed, int32_t pass) {
  int64_t *start = malloc(((size_t)n_vertices + 2) * sizeof *start), *edge = malloc((2 * (size_t)n_links + 1) * sizeof *edge);
  queue ahead = {0};
  int outcome = start && edge ? 0 : NO_MEMORY;
  if (outcome == 0) list_links(n_links, from, to, n_vertices, start, edge);
  for (int32_t lane = 0; lane < n_sources && outcome == 0; lane++) {
    double *times = table + lane;
    ahead.n = 0;
    for (int32_t v = 0; v < n_vertices && outcome == 0; v++)
      if (changed[v] >= pass - 2 && times[(int64_t)v * stride] < INFINITY) outcome = queue_push(&ahead, times[(int64_t)v * stride], v);
    while (ahead.n > 0 && outcome == 0) {
      entry here = queue_pop(&ahead);
      if (here.at > times[(int64_t)here.vertex * stride]) continue;
      for (int64_t k = start[here.vertex]; k < start[here.vertex + 1] && outcome == 0; k++) {
        int64_t i = edge[k];
        int32_t other = from[i] == here.vertex ? to[i] : from[i];
        if (here.at + time[i] >= times[(int64_t)other * stride]) continue;
        times[(int64_t)other * stride] = here.at + time[i];
        outcome = queue_push(&ahead, here.at + time[i], other);
      }
    }
  }
  free(start);
  free(edge);
  free(ahead.heap);
  return outcome;
}

/* Measure from n_sources distinct vertices to all; rows of `out` have n_sources numbers, but there is room for rows of the next multiple of
   four. Returns the number of passes, or a negative number. */
KERNEL int sweep_times(int64_t n_links, const int32_t *from, const int32_t *to, const double *time, int32_t n_vertices, int32_t n_sources,
                       const int32_t *sources, double *out) {
  int32_t stride = (n_sources + WHOLE - 1) / WHOLE * WHOLE;
  size_t size = (size_t)n_vertices * (size_t)stride;
  double *table = out;
  int32_t *changed = malloc(((size_t)n_vertices + 1) * sizeof *changed);
  int32_t pass = changed ? 0 : NO_MEMORY;
  if (pass == 0) {
    for (size_t i = 0; i < size; i++) table[i] = INFINITY;
    for (int32_t v = 0; v < n_vertices; v++) changed[v] = -3;
    for (int32_t i = 0; i < n_sources; i++) {
      table[(int64_t)sources[i] * stride + i] = 0;
      changed[sources[i]] = 0;
    }
    int quiet = 0;
    while (quiet < 2 && pass < MOST_PASSES) {
      pass++;
      quiet = pass_once(n_links, from, to, time, table, stride, changed, pass) ? 0 : quiet + 1;
      close_table(table, stride, sources, n_sources, changed, pass);
    }
    if (quiet < 2 && search_on(n_links, from, to, time, n_vertices, table, stride, n_sources, changed, pass) < 0) pass = NO_MEMORY;
    for (int32_t v = 1; v < n_vertices && stride != n_sources; v++)
      memmove(out + (int64_t)v * n_sources, table + (int64_t)v * stride, (size_t)n_sources * sizeof *out);
  }
  free(changed);
  return pass;
}
