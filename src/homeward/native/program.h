/* What comes before every program that is written by hand. */

/* What comes before a function that a wheel holds once for each level of x86-64, of which the
 * loader takes the one of the processor that it finds. ARM has one level, and NEON in it. */
#if defined(FOR_ALL_PROCESSORS) && defined(__x86_64__)
#define EACH_PROCESSOR \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"), flatten))
#else
#define EACH_PROCESSOR
#endif

/* Runs side by side: one. It is what a library is asked to prove that it can be loaded. */
int homeward_lanes(void) { return 1; }
