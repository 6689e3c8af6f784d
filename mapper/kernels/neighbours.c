/* Searches along the graph that stop early: nearest neighbours, and maxmin subsampling with the distances inside the subsample. */
#include "kernels.h"
#include "queue.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  double reached; /* at the vertex that the edge leads to */
  int64_t edge;
  int64_t stop; /* end of the row that the edge is in */
  double base;  /* at the vertex that the row belongs to */
} lead;

/* A binary heap, earliest first; there is room for one lead more than has been settled. */
static void lead_down(lead *heap, int32_t n, int32_t at, lead fresh) {
  for (int32_t child; (child = 2 * at + 1) < n; at = child) {
    if (child + 1 < n && heap[child + 1].reached < heap[child].reached) child++;
    if (fresh.reached <= heap[child].reached) break;
    heap[at] = heap[child];
  }
  heap[at] = fresh;
}

static void lead_push(lead *heap, int32_t *n, lead fresh) {
  int32_t at = (*n)++;
  for (int32_t parent; at > 0 && heap[parent = (at - 1) / 2].reached > fresh.reached; at = parent) heap[at] = heap[parent];
  heap[at] = fresh;
}

/* Sum the times from an encounter of each vertex to the k encounters nearest to it, for vertices begin .. end - 1.

   Rows are sorted by time and each settled vertex has only its next edge in the heap, so a landmark with thousands of edges costs no more
   than another vertex. The others of the same vertex are at distance zero. */
KERNEL int sum_neighbours(const int64_t *row_start, const int32_t *neighbour, const double *time, const int32_t *multiplicity,
                          int32_t n_vertices, int32_t begin, int32_t end, int64_t k, double *sums) {
  /* Every settled vertex counts for one at least, so no more than k + 1 are settled. */
  int64_t room = (k < n_vertices ? k : n_vertices) + 2;
  lead *heap = malloc((size_t)room * sizeof *heap);
  int32_t *settled_by = malloc(((size_t)n_vertices + 1) * sizeof *settled_by);
  if (!heap || !settled_by) {
    free(heap);
    free(settled_by);
    return NO_MEMORY;
  }
  for (int32_t v = 0; v < n_vertices; v++) settled_by[v] = -1;
  for (int32_t source = begin; source < end; source++) {
    int64_t wanted = k - (multiplicity[source] - 1);
    double total = 0;
    int32_t n = 0;
    settled_by[source] = source;
    if (wanted > 0 && row_start[source] < row_start[source + 1])
      lead_push(heap, &n, (lead){time[row_start[source]], row_start[source], row_start[source + 1], 0});
    while (n > 0 && wanted > 0) {
      lead best = heap[0];
      int32_t v = neighbour[best.edge];
      if (best.edge + 1 < best.stop) lead_down(heap, n, 0, (lead){best.base + time[best.edge + 1], best.edge + 1, best.stop, best.base});
      else if (--n > 0) lead_down(heap, n, 0, heap[n]);
      if (settled_by[v] == source) continue;
      settled_by[v] = source;
      total += best.reached * (double)(wanted < multiplicity[v] ? wanted : multiplicity[v]);
      wanted -= multiplicity[v];
      if (row_start[v] < row_start[v + 1])
        lead_push(heap, &n, (lead){best.reached + time[row_start[v]], row_start[v], row_start[v + 1], best.reached});
    }
    sums[source] = total;
  }
  free(heap);
  free(settled_by);
  return 0;
}

/* What a subsample needs: the graph, the hubs all long paths go through, and how far vertices are from the picks. */
typedef struct {
  const int64_t *row_start;
  const int32_t *neighbour;
  const double *time;
  int32_t n_vertices, n_hubs;
  const double *from_hubs; /* [n_vertices * n_hubs] */
  uint8_t *is_hub;
  double *found;    /* [n_vertices] of the search under way: paths that touch no hub; inf elsewhere */
  double *nearest;  /* [n_vertices] to the nearest pick along such paths */
  double *hub_near; /* [n_hubs] from the nearest pick to each hub */
  int32_t *touched;
  queue ahead;
} field;

TWICE static double through_hubs(const double *a, const double *b, int32_t n) {
  double best = INFINITY;
  for (int32_t i = 0; i < n; i++) {
    double sum = a[i] + b[i];
    best = sum < best ? sum : best;
  }
  return best;
}

/* Search from a pick along paths that touch no hub, only as far as they are shorter than those over a hub; return how many were reached. With
   `is_pruned` only as far as this pick is nearer than the others are: what lies beyond is nearer to one of them too. */
static int64_t search(field *f, int32_t pick, int is_pruned) {
  int64_t n_touched = 0;
  if (f->is_hub[pick]) return 0;
  const double *own = f->from_hubs + (int64_t)pick * f->n_hubs;
  f->found[pick] = 0;
  f->touched[n_touched++] = pick;
  f->ahead.n = 0;
  if (queue_push(&f->ahead, 0, pick) < 0) return NO_MEMORY;
  while (f->ahead.n > 0) {
    entry here = queue_pop(&f->ahead);
    if (here.at > f->found[here.vertex]) continue;
    if (through_hubs(own, f->from_hubs + (int64_t)here.vertex * f->n_hubs, f->n_hubs) <= here.at) continue;
    for (int64_t e = f->row_start[here.vertex]; e < f->row_start[here.vertex + 1]; e++) {
      int32_t v = f->neighbour[e];
      double at = here.at + f->time[e];
      if (f->is_hub[v] || at >= f->found[v] || (is_pruned && at >= f->nearest[v])) continue;
      if (f->found[v] == INFINITY) f->touched[n_touched++] = v;
      f->found[v] = at;
      if (queue_push(&f->ahead, at, v) < 0) return NO_MEMORY;
    }
  }
  return n_touched;
}

/* Vertices that all unpruned searches together may reach, in shares of all: a sweep of the picks costs about as much. */
enum { SEARCHES = 10 };

static double distance_to_picks(const field *f, int32_t v) {
  double over_hub = through_hubs(f->hub_near, f->from_hubs + (int64_t)v * f->n_hubs, f->n_hubs);
  return f->nearest[v] < over_hub ? f->nearest[v] : over_hub;
}

/* A heap of candidates, the furthest first and of equals the earliest; a value may be out of date, but only too high. */
typedef struct {
  double value;
  int32_t vertex;
} candidate;

static int is_further(candidate a, candidate b) { return a.value > b.value || (a.value == b.value && a.vertex < b.vertex); }

static void sink(candidate *heap, int32_t n, int32_t place) {
  candidate moving = heap[place];
  for (int64_t child; (child = 2 * (int64_t)place + 1) < n; place = (int32_t)child) {
    if (child + 1 < n && is_further(heap[child + 1], heap[child])) child++;
    if (!is_further(heap[child], moving)) break;
    heap[place] = heap[child];
  }
  heap[place] = moving;
}

static int64_t make_heap(const field *f, const uint8_t *is_candidate, int32_t first, candidate *heap) {
  int32_t n = 0;
  for (int32_t v = first; v < f->n_vertices; v++)
    if (is_candidate[v]) heap[n++] = (candidate){distance_to_picks(f, v), v};
  for (int32_t place = n / 2; place >= 0 && n > 0; place--) sink(heap, n, place);
  return n;
}

static candidate find_furthest(const field *f, candidate *heap, int32_t n) {
  for (;;) {
    double value = distance_to_picks(f, heap[0].vertex);
    if (value == heap[0].value) return heap[0];
    heap[0].value = value;
    sink(heap, n, 0);
  }
}

static void settle(field *f, int32_t pick, int64_t n_touched) {
  for (int64_t i = 0; i < n_touched; i++) {
    int32_t v = f->touched[i];
    if (f->found[v] < f->nearest[v]) f->nearest[v] = f->found[v];
    f->found[v] = INFINITY;
  }
  const double *own = f->from_hubs + (int64_t)pick * f->n_hubs;
  for (int32_t h = 0; h < f->n_hubs; h++)
    if (own[h] < f->hub_near[h]) f->hub_near[h] = own[h];
}

static int32_t pick_all(field *f, const uint8_t *is_candidate, int32_t first, int32_t n_points, candidate *heap, int32_t *picks,
                        double *distances, int32_t *is_complete, double *cover_radius) {
  int32_t n_picks = 0, next = first;
  int64_t n_left = f->n_hubs ? SEARCHES * (int64_t)f->n_vertices : 0;
  int64_t n_candidates = 0;
  candidate furthest = {INFINITY, first};
  while (n_picks < n_points && furthest.value > 0) {
    int is_pruned = n_left <= 0;
    int64_t n_touched = search(f, next, is_pruned);
    if (n_touched < 0) return NO_MEMORY;
    n_left -= n_touched;
    const double *own = f->from_hubs + (int64_t)next * f->n_hubs;
    *is_complete &= !is_pruned;
    for (int32_t j = 0; j < n_picks && *is_complete; j++) {
      double over_hub = through_hubs(own, f->from_hubs + (int64_t)picks[j] * f->n_hubs, f->n_hubs), direct = f->found[picks[j]];
      distances[(int64_t)n_picks * n_points + j] = distances[(int64_t)j * n_points + n_picks] = direct < over_hub ? direct : over_hub;
    }
    settle(f, next, n_touched);
    picks[n_picks++] = next;
    if (n_picks == 1) n_candidates = make_heap(f, is_candidate, first, heap);
    furthest = find_furthest(f, heap, (int32_t)n_candidates);
    next = furthest.vertex;
  }
  *cover_radius = furthest.value;
  return n_picks;
}

/* Pick up to n_points candidates, each the furthest from those before it; the first is the earliest candidate, ties go to the earlier.

   from_hubs holds the times from every vertex to each of n_hubs vertices. Good hubs keep the searches short, and `distances` (n_points *
   n_points) come with them. Where they do not, or where there are none, each search ends where an earlier pick is nearer; distances are then not
   known, and is_complete is 0. Returns how many were picked: fewer where every candidate is at distance zero from a pick; or a negative number. */
KERNEL int32_t pick_maxmin(const int64_t *row_start, const int32_t *neighbour, const double *time, int32_t n_vertices, int32_t n_hubs,
                           const int32_t *hubs, const double *from_hubs, const uint8_t *is_candidate, int32_t n_points, int32_t *picks,
                           double *distances, int32_t *is_complete, double *cover_radius) {
  size_t room = (size_t)n_vertices + 1;
  field f = {row_start, neighbour, time, n_vertices, n_hubs, from_hubs, calloc(room, 1), malloc(room * sizeof(double)),
             malloc(room * sizeof(double)), malloc(((size_t)n_hubs + 1) * sizeof(double)), malloc(room * sizeof(int32_t)), {0}};
  candidate *heap = malloc(room * sizeof *heap);
  int32_t n_picks = f.is_hub && f.found && f.nearest && f.hub_near && f.touched && heap ? 0 : NO_MEMORY;
  if (n_picks == 0) {
    for (int32_t v = 0; v < n_vertices; v++) f.found[v] = f.nearest[v] = INFINITY;
    for (int32_t h = 0; h < n_hubs; h++) {
      f.hub_near[h] = INFINITY;
      f.is_hub[hubs[h]] = 1;
    }
    int32_t first = 0;
    while (first < n_vertices && !is_candidate[first]) first++;
    *cover_radius = 0;
    *is_complete = 1;
    if (first < n_vertices) n_picks = pick_all(&f, is_candidate, first, n_points, heap, picks, distances, is_complete, cover_radius);
  }
  free(f.is_hub);
  free(f.found);
  free(f.nearest);
  free(f.hub_near);
  free(f.touched);
  free(f.ahead.heap);
  free(heap);
  return n_picks;
}
