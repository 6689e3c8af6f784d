/* The mapper's compiled kernels: graph, sweeps, neighbours, subsamples and profiles of encounters, and rows of files of them.

   Every function is pure: arrays in, arrays out, nothing kept between calls; several threads may call at a time. Times are whole ticks held in
   doubles (exact up to 2^53); vertices, encounters and links are 32-bit numbers, so a table holds at most 2^31 - 1 encounters.
   A function that needs working memory returns a negative number where there is none. */
#ifndef BIOBOT_KERNELS_H
#define BIOBOT_KERNELS_H

#include <stdint.h>
#include <stddef.h>

#define KERNEL __attribute__((visibility("default")))

/* Hot loops are compiled twice on x86-64, and the processor picks: results do not depend on it, since nothing is rounded differently. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define TWICE __attribute__((target_clones("avx2", "default")))
#else
#define TWICE
#endif

#define NO_MEMORY (-1)

/* A landmark's or a natural stop, times in ticks since the origin, both ends inside; sorted by node, then begin; disjoint for a node. */
typedef struct {
  int64_t node;
  int64_t begin;
  int64_t end;
} spell;

/* What build_graph fills; the caller has made room for the upper bounds in brackets. */
typedef struct {
  int32_t n_vertices;
  int32_t n_components;
  int64_t n_links;
  int64_t n_edges;
  int32_t *vertex_of;       /* [n] vertex of each encounter */
  int32_t *first_encounter; /* [n] earliest encounter of each vertex, ascending */
  int32_t *multiplicity;    /* [n] encounters of each vertex */
  uint8_t *is_landmark;     /* [n] by vertex: a landmark stood there */
  int32_t *component;       /* [n] by vertex, numbered by their first vertices */
  int32_t *link_from;       /* [2n] links in the order of time, from the earlier encounter to the later */
  int32_t *link_to;         /* [2n] */
  double *link_time;        /* [2n] ticks, above 0 */
  int32_t *link_before;     /* [2n] the link before of the same biobot, to where this one begins; -1 for none */
  int64_t *row_start;       /* [n + 1] edges of each vertex */
  int32_t *neighbour;       /* [4n] sorted by time within a row, then by vertex; each once */
  double *time;             /* [4n] */
} graph;

#endif
