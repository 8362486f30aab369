/* model/sim/rng.h
 * Seeded random numbers for simulations: xoshiro256++ (Blackman, Vigna 2018), initialised by splitmix64. A seed gives
 * the same sequence, bit for bit, with every compiler: integer arithmetic, and only log() and sqrt() of libm. */
#ifndef MODEL_SIM_RNG_H
#define MODEL_SIM_RNG_H

#include <stdint.h>

struct rng {
	uint64_t state[4];
	double spare; /* the polar method makes two Gaussian numbers at a time */
	int has_spare;
};

/** Any seed is valid, including 0; neighbouring seeds give unrelated sequences. */
void rng_init(struct rng *rng, uint64_t seed);
uint64_t rng_u64(struct rng *rng);
/** Uniform in [0, 1), with 53 bits. */
double rng_uniform(struct rng *rng);
/** Normal: mean 0, standard deviation 1. */
double rng_gauss(struct rng *rng);

#endif
