/* From encounters to the contracted graph, in one pass over them in the order of their centres ([Dir16] eq. 6-7). */
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

/* What the pass knows of one biobot. */
typedef struct {
  int64_t node;
  int32_t last;                                   /* its encounter before, -1 before the first */
  int32_t last_link;                              /* its link before, -1 before the first */
  int64_t clock;                                  /* its clock then */
  int64_t place;                                  /* the stand it was in then, -1 for none */
  int64_t walked_from;                            /* time inside the static spells that are over */
  int64_t still, still_end, stand, stand_end;     /* the rest of its static and of its commanded spells */
} walker;

typedef struct {
  walker *walkers;
  int32_t n_walkers, capacity;
  int32_t *slots; /* open addressing: index of a walker + 1, or 0 */
  uint64_t mask;
} crowd;

static uint64_t mix(uint64_t x) {
  x ^= x >> 33;
  x *= 0xff51afd7ed558ccdULL;
  x ^= x >> 33;
  return x;
}

static int64_t first_of_node(const spell *spells, int64_t n, int64_t node) {
  int64_t low = 0, high = n;
  while (low < high) {
    int64_t middle = low + (high - low) / 2;
    if (spells[middle].node < node) low = middle + 1;
    else high = middle;
  }
  return low;
}

static int grow(crowd *all) {
  int32_t capacity = all->capacity ? 2 * all->capacity : 256;
  walker *walkers = realloc(all->walkers, (size_t)capacity * sizeof *walkers);
  if (!walkers) return NO_MEMORY;
  all->walkers = walkers;
  int32_t *slots = calloc(4 * (size_t)capacity, sizeof *slots);
  if (!slots) return NO_MEMORY;
  free(all->slots);
  all->slots = slots;
  all->capacity = capacity;
  all->mask = 4 * (uint64_t)capacity - 1;
  for (int32_t i = 0; i < all->n_walkers; i++) {
    uint64_t at = mix((uint64_t)walkers[i].node) & all->mask;
    while (slots[at]) at = (at + 1) & all->mask;
    slots[at] = i + 1;
  }
  return 0;
}

static int32_t find_walker(crowd *all, int64_t node, const spell *still, int64_t n_still, const spell *stands, int64_t n_stands) {
  if (all->n_walkers == all->capacity && grow(all) < 0) return NO_MEMORY;
  uint64_t at = mix((uint64_t)node) & all->mask;
  for (; all->slots[at]; at = (at + 1) & all->mask)
    if (all->walkers[all->slots[at] - 1].node == node) return all->slots[at] - 1;
  walker *fresh = &all->walkers[all->n_walkers];
  *fresh = (walker){.node = node, .last = -1, .last_link = -1, .place = -1};
  fresh->still = fresh->still_end = first_of_node(still, n_still, node);
  while (fresh->still_end < n_still && still[fresh->still_end].node == node) fresh->still_end++;
  fresh->stand = fresh->stand_end = first_of_node(stands, n_stands, node);
  while (fresh->stand_end < n_stands && stands[fresh->stand_end].node == node) fresh->stand_end++;
  all->slots[at] = ++all->n_walkers;
  return all->n_walkers - 1;
}

/* Its own clock at an instant: elapsed time, less what it stood still. Instants come in ascending order. */
static int64_t read_clock(walker *w, const spell *still, int64_t at) {
  while (w->still < w->still_end && still[w->still].end <= at) {
    w->walked_from += still[w->still].end - still[w->still].begin;
    w->still++;
  }
  int64_t running = w->still < w->still_end && still[w->still].begin <= at ? at - still[w->still].begin : 0;
  return at - w->walked_from - running;
}

static int64_t find_place(walker *w, const spell *stands, int64_t at) {
  while (w->stand + 1 < w->stand_end && stands[w->stand + 1].begin <= at) w->stand++;
  return w->stand < w->stand_end && stands[w->stand].begin <= at && at <= stands[w->stand].end ? w->stand : -1;
}

static int32_t find_root(int32_t *parent, int32_t x) {
  while (parent[x] != x) {
    parent[x] = parent[parent[x]];
    x = parent[x];
  }
  return x;
}

/* The lower number becomes the root, so that a root is the earliest of its set. */
static void join(int32_t *parent, int32_t a, int32_t b) {
  a = find_root(parent, a);
  b = find_root(parent, b);
  if (a < b) parent[b] = a;
  else parent[a] = b;
}

/* Order by key, equal keys by number; 11 bits a pass, only the bits there are. */
static int order_by(const int64_t *key, int32_t n, int32_t *order) {
  uint64_t all = 0;
  int is_sorted = 1;
  for (int32_t i = 0; i < n; i++) {
    order[i] = i;
    all |= (uint64_t)key[i];
    is_sorted &= i == 0 || key[i - 1] <= key[i];
  }
  if (is_sorted) return 0;
  int32_t *other = malloc((size_t)n * sizeof *other);
  if (!other) return NO_MEMORY;
  int32_t *from = order, *to = other;
  for (int shift = 0; shift < 64 && all >> shift; shift += 11) {
    int64_t count[2049] = {0};
    for (int32_t i = 0; i < n; i++) count[((uint64_t)key[i] >> shift & 2047) + 1]++;
    int is_needed = 1;
    for (int digit = 1; digit <= 2048; digit++) is_needed &= count[digit] != n;
    if (!is_needed) continue;
    for (int digit = 1; digit < 2048; digit++) count[digit] += count[digit - 1];
    for (int32_t i = 0; i < n; i++) to[count[(uint64_t)key[from[i]] >> shift & 2047]++] = from[i];
    int32_t *swap = from;
    from = to;
    to = swap;
  }
  if (from != order) memcpy(order, from, (size_t)n * sizeof *order);
  free(other);
  return 0;
}

static int is_after(double time, int32_t vertex, double other_time, int32_t other) {
  return time > other_time || (time == other_time && vertex > other);
}

/* Sort one row by time, then vertex. Most rows have four edges; a landmark's has thousands and is merged bottom up. */
static void sort_row(double *time, int32_t *vertex, int64_t n, double *spare_time, int32_t *spare_vertex) {
  enum { RUN = 16 };
  for (int64_t begin = 0; begin < n; begin += RUN) {
    int64_t end = begin + RUN < n ? begin + RUN : n;
    for (int64_t i = begin + 1; i < end; i++) {
      double t = time[i];
      int32_t v = vertex[i];
      int64_t j = i;
      for (; j > begin && is_after(time[j - 1], vertex[j - 1], t, v); j--) {
        time[j] = time[j - 1];
        vertex[j] = vertex[j - 1];
      }
      time[j] = t;
      vertex[j] = v;
    }
  }
  double *from_time = time, *to_time = spare_time;
  int32_t *from_vertex = vertex, *to_vertex = spare_vertex;
  for (int64_t run = RUN; run < n; run *= 2) {
    for (int64_t begin = 0; begin < n; begin += 2 * run) {
      int64_t middle = begin + run < n ? begin + run : n, end = begin + 2 * run < n ? begin + 2 * run : n;
      int64_t a = begin, b = middle;
      for (int64_t i = begin; i < end; i++) {
        int take_first = a < middle && (b == end || !is_after(from_time[a], from_vertex[a], from_time[b], from_vertex[b]));
        int64_t taken = take_first ? a++ : b++;
        to_time[i] = from_time[taken];
        to_vertex[i] = from_vertex[taken];
      }
    }
    double *swap_time = from_time;
    from_time = to_time;
    to_time = swap_time;
    int32_t *swap_vertex = from_vertex;
    from_vertex = to_vertex;
    to_vertex = swap_vertex;
  }
  if (from_time != time) {
    memcpy(time, from_time, (size_t)n * sizeof *time);
    memcpy(vertex, from_vertex, (size_t)n * sizeof *vertex);
  }
}

/* Both directions of every link, the shortest of parallel ones, rows sorted. */
static int make_rows(graph *g) {
  int32_t v = g->n_vertices;
  int64_t *start = g->row_start;
  memset(start, 0, (size_t)(v + 1) * sizeof *start);
  for (int64_t i = 0; i < g->n_links; i++) {
    start[g->link_from[i] + 1]++;
    start[g->link_to[i] + 1]++;
  }
  int64_t longest = 0;
  for (int32_t i = 0; i < v; i++) {
    if (start[i + 1] > longest) longest = start[i + 1];
    start[i + 1] += start[i];
  }
  int64_t *next = malloc((size_t)(v + 1) * sizeof *next);
  double *spare_time = malloc((size_t)(longest + 1) * sizeof *spare_time);
  int32_t *spare_vertex = malloc((size_t)(longest + 1) * sizeof *spare_vertex), *seen_by = malloc((size_t)(v + 1) * sizeof *seen_by);
  int outcome = next && spare_time && spare_vertex && seen_by ? 0 : NO_MEMORY;
  if (outcome == 0) {
    memcpy(next, start, (size_t)(v + 1) * sizeof *next);
    for (int64_t i = 0; i < g->n_links; i++) {
      int32_t a = g->link_from[i], b = g->link_to[i];
      g->neighbour[next[a]] = b;
      g->time[next[a]++] = g->link_time[i];
      g->neighbour[next[b]] = a;
      g->time[next[b]++] = g->link_time[i];
    }
    for (int32_t i = 0; i < v; i++) seen_by[i] = -1;
    int64_t kept = 0;
    for (int32_t i = 0; i < v; i++) {
      int64_t begin = start[i], end = start[i + 1];
      sort_row(g->time + begin, g->neighbour + begin, end - begin, spare_time, spare_vertex);
      start[i] = kept;
      for (int64_t e = begin; e < end; e++) {
        int32_t u = g->neighbour[e];
        if (seen_by[u] == i) continue;
        seen_by[u] = i;
        g->neighbour[kept] = u;
        g->time[kept++] = g->time[e];
      }
    }
    start[v] = kept;
    g->n_edges = kept;
  }
  free(next);
  free(spare_time);
  free(spare_vertex);
  free(seen_by);
  return outcome;
}

static void name_components(graph *g, int32_t *parent) {
  for (int32_t i = 0; i < g->n_vertices; i++) parent[i] = i;
  for (int64_t i = 0; i < g->n_links; i++) join(parent, g->link_from[i], g->link_to[i]);
  g->n_components = 0;
  for (int32_t i = 0; i < g->n_vertices; i++) {
    int32_t root = find_root(parent, i);
    g->component[i] = root == i ? g->n_components++ : g->component[root];
  }
}

/* One pass: chains of every biobot; what lies at distance zero is joined, the rest becomes links between encounters. */
static int walk_chains(const int64_t *centre, const int32_t *order, int32_t n, const int64_t *ids[2], const spell *still, int64_t n_still,
                       const spell *stands, int64_t n_stands, int moving_time, int32_t *parent, uint8_t *stood, graph *g) {
  crowd all = {0};
  g->n_links = 0;
  int outcome = 0;
  for (int32_t i = 0; i < n && outcome == 0; i++) {
    int32_t e = order[i];
    for (int side = 0; side < 2; side++) {
      int32_t index = find_walker(&all, ids[side][e], still, n_still, stands, n_stands);
      if (index < 0) {
        outcome = NO_MEMORY;
        break;
      }
      walker *w = &all.walkers[index];
      int64_t clock = moving_time ? read_clock(w, still, centre[e]) : centre[e], place = find_place(w, stands, centre[e]);
      stood[e] |= place >= 0;
      if (w->last >= 0) {
        if (clock == w->clock || (place >= 0 && place == w->place)) {
          join(parent, w->last, e);
        } else {
          g->link_from[g->n_links] = w->last;
          g->link_to[g->n_links] = e;
          g->link_before[g->n_links] = w->last_link;
          w->last_link = (int32_t)g->n_links;
          g->link_time[g->n_links++] = (double)(clock - w->clock);
        }
      }
      w->last = e;
      w->clock = clock;
      w->place = place;
    }
  }
  free(all.walkers);
  free(all.slots);
  return outcome;
}

/* Contract to vertices, numbered by their earliest encounters; links inside one vertex are dropped. `number` has room for every link. */
static void contract(int32_t n, int32_t *parent, const uint8_t *stood, int32_t *number, graph *g) {
  g->n_vertices = 0;
  memset(g->multiplicity, 0, (size_t)n * sizeof *g->multiplicity);
  memset(g->is_landmark, 0, (size_t)n);
  for (int32_t e = 0; e < n; e++) {
    int32_t root = find_root(parent, e);
    if (root == e) {
      g->first_encounter[g->n_vertices] = e;
      g->vertex_of[e] = g->n_vertices++;
    } else {
      g->vertex_of[e] = g->vertex_of[root];
    }
    g->multiplicity[g->vertex_of[e]]++;
    g->is_landmark[g->vertex_of[e]] |= stood[e];
  }
  int64_t kept = 0;
  for (int64_t i = 0; i < g->n_links; i++) {
    int32_t a = g->vertex_of[g->link_from[i]], b = g->vertex_of[g->link_to[i]];
    number[i] = a == b ? -1 : (int32_t)kept;
    if (a == b) continue;
    int32_t before = g->link_before[i];
    g->link_from[kept] = a;
    g->link_to[kept] = b;
    g->link_before[kept] = before < 0 ? -1 : number[before];
    g->link_time[kept++] = g->link_time[i];
  }
  g->n_links = kept;
}

/* Build the graph of n encounters. Centres are in ticks since the origin, not negative. Returns 0, or a negative number. */
KERNEL int build_graph(const int64_t *centre, const int64_t *id1, const int64_t *id2, int32_t n, const spell *still, int64_t n_still,
                       const spell *stands, int64_t n_stands, int32_t moving_time, graph *g) {
  size_t room = (size_t)n + 1;
  int32_t *order = malloc(room * sizeof *order), *parent = malloc(room * sizeof *parent), *number = malloc(2 * room * sizeof *number);
  uint8_t *stood = calloc(room, 1);
  const int64_t *ids[2] = {id1, id2};
  int outcome = order && parent && number && stood ? order_by(centre, n, order) : NO_MEMORY;
  if (outcome == 0) {
    for (int32_t e = 0; e < n; e++) parent[e] = e;
    outcome = walk_chains(centre, order, n, ids, still, n_still, stands, n_stands, moving_time, parent, stood, g);
  }
  if (outcome == 0) {
    contract(n, parent, stood, number, g);
    name_components(g, parent);
    outcome = make_rows(g);
  }
  free(order);
  free(parent);
  free(number);
  free(stood);
  return outcome;
}

/* What the other side of the interface checks before it calls anything: the layout, and the CRC-32 of the sources, given by the build. */
KERNEL int64_t kernels_layout(void) { return 1000 * (int64_t)sizeof(graph) + (int64_t)sizeof(spell); }
KERNEL int64_t kernels_sources(void) { return SOURCES; }
