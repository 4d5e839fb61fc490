/* Start of a Cortex-M4F: a vector table, and the floating-point unit switched on. */
#include <stdint.h>

extern uint32_t stack_top;
void _start(void);
void reset(void);
void fault(void);

void reset(void) {
  *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* CPACR: full access to CP10 and CP11 */
  _start();
}

void fault(void) {
  for (;;) {
  }
}

__attribute__((section(".vectors"), used)) static const void *const vectors[] = {
    &stack_top, (void *)reset, (void *)fault, (void *)fault, (void *)fault, (void *)fault,
    (void *)fault,
};
