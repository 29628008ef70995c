"""The loop on the machine in C: the law at absolute deadlines on a robot that speaks UDP."""

from collections.abc import Sequence
from pathlib import Path
from string import Template

from tarc.core.array_ops import HUGE
from tarc.core.files import read_text
from tarc.export.c_source import CSource

LOOP = Path(__file__).parent / "machine" / "loop.c"
"""The loop, a template: $name and the like stand for what is of the law."""

EXPORTED = Template("""  real q[JOINTS], v[JOINTS], a[JOINTS];
  (void)rest;
  (void)${name}_reference((real)time, q, v, a);
  for (int i = 0; i < JOINTS; ++i) {
    p->position[i] = (double)q[i];
    p->velocity[i] = (double)v[i];
    p->acceleration[i] = (double)a[i];
  }
""")

AT_REST = """  (void)time; /* rest where it started: write your own motion with its two derivatives here */
  memset(p, 0, sizeof *p);
  memcpy(p->position, rest, sizeof p->position);
"""

MAKEFILE = Template("""# The loop on the machine: Linux with the C library's real-time functions.
CC ?= cc
CFLAGS ?= -O2

loop: loop.c $sources ../src/$name.h
	$$(CC) -std=c99 -ffp-contract=off $$(CFLAGS) -I../src loop.c $sources -lm -o $$@
""")


def realtime_texts(source: CSource, joints: Sequence[str], *, follows_reference: bool) -> dict[str, str]:
    """Return the text of each file by its path.

    Parameters
    ----------
    source
        C of the law.
    joints
        Names of the joints, which the robot must have in this order; empty for any.
    follows_reference
        Whether the parts of the C have the reference, which is then followed.
    """
    name = source.name
    limits = [f"{limit!r}" if limit < HUGE else "1e100" for limit in map(float, source.traced.start_limits)]
    values = {
        "name": name,
        "NAME": name.upper(),
        "header": f"{name}_parts.h" if follows_reference else f"{name}.h",
        "limits": ", ".join(limits),
        "names": "\\n".join(joints).replace('"', '\\"'),
        "max_missing": str(source.traced.law.max_missing),
        "reference": EXPORTED.substitute(name=name) if follows_reference else AT_REST,
        "elapsed": "  in.elapsed = is_new ? (real)since_sample : 0;\n" if source.traced.watch else "",
        "watched": _watched(source),
        "sources": f"../src/{name}.c" + (f" ../src/{name}_parts.c" if follows_reference else ""),
    }
    return {
        "realtime/loop.c": Template(read_text("realtime", LOOP)).substitute(values),
        "realtime/Makefile": MAKEFILE.substitute(values),
    }


def _watched(source: CSource) -> str:
    """Return C that prints what left the range that was certified; empty where nothing is watched."""
    if source.traced.watch is None:
        return ""
    lines = ['  printf("left what was certified:");']
    for flag in source.traced.watch.watched:
        name = flag.name or ""
        lines.append(f'  printf("%s", out.flags_seen & {source.name.upper()}_FLAG_{name} ? " {name.lower()}" : "");')
    lines.append('  printf("%s\\n", out.flags_seen ? "" : " nothing");')
    return "\n".join(lines) + "\n"
