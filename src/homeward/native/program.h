/* Common header of the hand-written programs. */

/* Attribute of a function of which a wheel contains one version per level of x86-64; the loader
 * selects the version for the processor. ARM has one level, which includes NEON. */
#if defined(FOR_ALL_PROCESSORS) && defined(__x86_64__)
#define EACH_PROCESSOR \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"), flatten))
#else
#define EACH_PROCESSOR
#endif

/* Number of parallel runs: one. Called to test that a library can be loaded. */
int homeward_lanes(void) { return 1; }
