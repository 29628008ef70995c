"""Firmware that replays the recorded steps of a law on a Cortex-M, in QEMU or on a board with a debugger."""

from string import Template

from tarc.export.c_source import CSource
from tarc.export.tolerances import TOLERANCES

START = """/* Start-up of a Cortex-M: vectors, memory and floating point. */
#include "semihosting.h"

#include <stddef.h>
#include <stdint.h>
#include <string.h>

extern uint32_t stack_top, data_source, data_start, data_end, bss_start, bss_end; /* of mps2.ld */

int main(void);
void reset_handler(void);
void fault_handler(void);

typedef void handler(void);

__attribute__((used, section(".vectors"))) static const struct {
  const uint32_t *stack;
  handler *reset, *faults[14];
} vectors = {&stack_top,
             reset_handler,
             {fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler,
              fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler}};

void reset_handler(void)
{
#ifdef __ARM_FP
  *(volatile uint32_t *)0xe000ed88u |= 0xfu << 20; /* CPACR: floating point on */
  __asm__ volatile("dsb\\n isb" ::: "memory");
#endif
  memcpy(&data_start, &data_source, (size_t)((char *)&data_end - (char *)&data_start));
  memset(&bss_start, 0, (size_t)((char *)&bss_end - (char *)&bss_start));
  leave(main());
}

void fault_handler(void)
{
  print("the processor faulted\\n");
  leave(1);
}
"""

SEMIHOSTING = """/* Text and exit status to the debugger, or to QEMU. Without one BKPT faults. */
#ifndef SEMIHOSTING_H
#define SEMIHOSTING_H

static inline void semihosting_call(int operation, const void *argument)
{
  register int r0 __asm__("r0") = operation;
  register const void *r1 __asm__("r1") = argument;
  __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static inline void print(const char *text)
{
  semihosting_call(0x04, text); /* SYS_WRITE0 */
}

static inline void leave(int status)
{
  const int block[2] = {0x20026, status}; /* the program ended by itself */
  semihosting_call(0x20, block);          /* SYS_EXIT_EXTENDED */
  for (;;)
    ;
}

#endif
"""

MAIN = Template("""/* Replays the recorded steps on a Cortex-M and counts instructions. Exit status 0: all agree. */
#include "replay.h"
#include "semihosting.h"

#include <stdint.h>

/* SysTick counts the processor's clock down. QEMU with -icount shift=8 takes 256 ns for an instruction, and the mps2
 * boards have a clock of 25 MHz: 32 ticks are 5 instructions. On a board ticks are cycles. */
#define SYSTICK ((volatile uint32_t *)0xe000e010u)
#define SYSTICK_TOP 0xffffffu
#define TICKS 32u
#define INSTRUCTIONS 5u

static ${name}_t law;

static void print_number(uint64_t value)
{
  char digits[21], *place = digits + sizeof digits - 1;
  *place = 0;
  do {
    *--place = (char)('0' + value % 10);
    value /= 10;
  } while (value);
  print(place);
}

static uint32_t elapsed(uint32_t begin)
{
  return (begin - SYSTICK[2]) & SYSTICK_TOP;
}

int main(void)
{
  ${name}_input in;
  ${name}_output out;
  replay_result result = {0, 0, 0};
  uint64_t sum = 0;
  uint32_t longest = 0;
  const char *const fault = start(&law);
  if (fault) {
    print(fault);
    return 1;
  }
  SYSTICK[1] = SYSTICK_TOP;
  SYSTICK[2] = 0;
  SYSTICK[0] = 5; /* the processor's clock, no interrupt */
  const uint32_t none = SYSTICK[2], overhead = elapsed(none);
  for (int k = 0; k < VECTORS; ++k) {
    fill(&in, vector_inputs[k]);
    const uint32_t begin = SYSTICK[2];
    (void)${name}_step(&law, &in, &out);
    const uint32_t ticks = elapsed(begin) - overhead;
    sum += ticks;
    longest = ticks > longest ? ticks : longest;
    compare(&out, k, &result);
  }
  print(CORE ", $real: ");
  print_number(VECTORS);
  print(" steps, ");
  print_number((uint64_t)result.different);
  print(" of ");
  print_number((uint64_t)VECTORS * VECTOR_OUTPUTS);
  print(" numbers differ, by ");
  print_number(result.largest);
  print(" units of the last place at most; ");
  print_number((uint64_t)result.wrong);
  print(" by more than $tolerance\\n");
  print_number(sum * INSTRUCTIONS / ((uint64_t)TICKS * VECTORS));
  print(" instructions per step, ");
  print_number((uint64_t)longest * INSTRUCTIONS / TICKS);
  print(" at most\\n");
  return !is_right(&result);
}
""")

LINKER = """/* Memory of QEMU's mps2-an385, mps2-an386 and mps2-an500. For another processor change these two lines. */
MEMORY
{
  FLASH (rx) : ORIGIN = 0x00000000, LENGTH = 4M
  RAM (rwx) : ORIGIN = 0x20000000, LENGTH = 4M
}

ENTRY(reset_handler)

SECTIONS
{
  .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) . = ALIGN(4); } > FLASH
  .ARM.exidx : { *(.ARM.exidx*) } > FLASH
  .data : ALIGN(4) { data_start = .; *(.data*) . = ALIGN(4); data_end = .; } > RAM AT > FLASH
  data_source = LOADADDR(.data);
  .bss (NOLOAD) : ALIGN(4) { bss_start = .; *(.bss*) *(COMMON) . = ALIGN(4); bss_end = .; } > RAM
  stack_top = ORIGIN(RAM) + LENGTH(RAM);
}
"""

MAKEFILE = Template("""# make run: the recorded steps in QEMU, on a Cortex-M3 without floating point, an M4F and an M7
# make run OPT=-O3 CORES=cortex-m4: with another optimisation, on one of them
# It needs arm-none-eabi-gcc with newlib, and qemu-system-arm: of Debian the packages
# gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
CROSS ?= arm-none-eabi-
QEMU ?= qemu-system-arm
OPT ?= -O2
CORES ?= cortex-m3 cortex-m4 cortex-m7

board_cortex-m3 := mps2-an385
board_cortex-m4 := mps2-an386
board_cortex-m7 := mps2-an500
flags_cortex-m3 := -mfloat-abi=soft
flags_cortex-m4 := -mfloat-abi=hard -mfpu=fpv4-sp-d16
flags_cortex-m7 := -mfloat-abi=hard -mfpu=fpv5-d16

FLAGS := -std=c99 $$(OPT) -ffp-contract=off -ffunction-sections -fdata-sections
FLAGS += -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wmissing-prototypes -I../src -I../test
FILES := $name.c main.c start.c
HEADERS := $$(wildcard ../src/*.h ../test/*.h *.h) mps2.ld Makefile

vpath %.c . ../src

.PHONY: all run clean
.SECONDARY:

all: $$(CORES:%=build/%.elf)

run: $$(CORES:%=run-%)

run-%: build/%.elf
	@$$(QEMU) -M $$(board_$$*) -display none -serial none -monitor none -icount shift=8 \\
		-semihosting-config enable=on,target=native -kernel $$< 2>&1
	@$${CROSS}size build/$$*-$name.o | awk 'NR == 2 { print $$$$1 + $$$$2 " bytes of flash for the law" }'

build/%.elf: $$(FILES) $$(HEADERS)
	@mkdir -p build
	@for file in $$(filter %.c,$$^); do \\
		$${CROSS}gcc -mcpu=$$* -mthumb $$(flags_$$*) $$(FLAGS) '-DCORE="$$*"' -c $$$$file \\
			-o build/$$*-$$$$(basename $$$$file .c).o || exit 1; \\
	done
	@$${CROSS}gcc -mcpu=$$* -mthumb $$(flags_$$*) -nostartfiles --specs=nano.specs -Wl,--gc-sections -T mps2.ld \\
		$$(patsubst %.c,build/$$*-%.o,$$(FILES)) -lm -o $$@

clean:
	rm -rf build
""")


def firmware_texts(source: CSource) -> dict[str, str]:
    """Return the text of each file of the firmware by its path."""
    values = {"name": source.name, "real": source.real, "tolerance": TOLERANCES[source.real]}
    return {
        "firmware/start.c": START,
        "firmware/semihosting.h": SEMIHOSTING,
        "firmware/main.c": MAIN.substitute(values),
        "firmware/mps2.ld": LINKER,
        "firmware/Makefile": MAKEFILE.substitute(values),
    }
