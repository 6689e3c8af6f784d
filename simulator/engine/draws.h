/* Random draws as pure functions of (seed, biobot, stream, index): the arithmetic of simulator/draws.py, bit for bit.

   Only IEEE 754 operations that every machine rounds alike are used (+ - * / sqrt); compile without contraction. */
#ifndef BIOBOT_DRAWS_H
#define BIOBOT_DRAWS_H

#include <math.h>
#include <stdint.h>

#define DRAWS_LN_2 0.6931471805599453
#define DRAWS_TWO_PI 6.283185307179586

/* splitmix64: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014. */
static inline uint64_t draws_mix(uint64_t state) {
    state = (state ^ (state >> 30)) * 0xBF58476D1CE4E5B9u;
    state = (state ^ (state >> 27)) * 0x94D049BB133111EBu;
    return state ^ (state >> 31);
}

static inline uint64_t draws_word(uint64_t seed, uint64_t biobot, uint64_t stream, uint64_t index) {
    const uint64_t gamma = 0x9E3779B97F4A7C15u;
    uint64_t state = seed;
    state = draws_mix((state + gamma) ^ (biobot * gamma));
    state = draws_mix((state + gamma) ^ (stream * gamma));
    state = draws_mix((state + gamma) ^ (index * gamma));
    return draws_mix(state + gamma);
}

/* The middle of one of 2^52 equal parts of (0, 1): never 0, never 1. */
static inline double draws_uniform(uint64_t bits) { return ((double)(bits >> 12) + 0.5) * 0x1p-52; }

/* Natural logarithm of a positive finite number. */
static inline double draws_log(double value) {
    int exponent;
    double fraction = frexp(value, &exponent);
    if (fraction < 0.7071067811865476) {
        fraction = 2.0 * fraction;
        exponent -= 1;
    }
    /* ln m = 2 artanh((m - 1) / (m + 1)), |argument| < 0.172: the 12th term is below 1e-18. */
    double ratio = (fraction - 1.0) / (fraction + 1.0), square = ratio * ratio, series = 1.0 / 23.0;
    for (int odd = 21; odd > 0; odd -= 2) series = series * square + 1.0 / odd;
    return exponent * DRAWS_LN_2 + 2.0 * ratio * series;
}

/* Exponential variable of mean 1. */
static inline double draws_exponential(uint64_t bits) { return -draws_log(draws_uniform(bits)); }

/* e to a power between -700 and 700, within some units in the last place. */
static inline double draws_exp(double power) {
    double whole = floor(power / DRAWS_LN_2 + 0.5), rest = power - whole * DRAWS_LN_2, sum = 1.0;
    for (int n = 18; n > 0; n--) sum = 1.0 + sum * rest / n; /* |rest| < 0.35: the next term is below 1e-25 */
    return ldexp(sum, (int)whole);
}

/* Cosine and sine of an angle given in turns. */
static inline void draws_circle(double turns, double *x, double *y) {
    double quarter = rint(4.0 * turns), angle = (turns - 0.25 * quarter) * DRAWS_TWO_PI, square = angle * angle;
    double sine = 1.0, cosine = 1.0;
    for (int n = 16; n > 0; n -= 2) { /* Taylor series to angle^17 and angle^18: the next terms are below 1e-18 */
        sine = 1.0 - sine * square / (n * (n + 1.0));
        cosine = 1.0 - cosine * square / ((n + 2.0) * (n + 1.0));
    }
    cosine = 1.0 - cosine * square / 2.0;
    sine = sine * angle;
    int64_t turn = (int64_t)quarter & 3;
    double across = turn & 1 ? sine : cosine, up = turn & 1 ? cosine : sine;
    *x = turn == 1 || turn == 2 ? -across : across;
    *y = turn >= 2 ? -up : up;
}

/* Standard normal variable from two words (Box and Muller). */
static inline double draws_normal(uint64_t first, uint64_t second) {
    double cosine, sine;
    draws_circle(draws_uniform(second), &cosine, &sine);
    return sqrt(2.0 * draws_exponential(first)) * cosine;
}

#endif
