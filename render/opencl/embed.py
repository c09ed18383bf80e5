#!/usr/bin/env python3
"""Joins a kernel file and all that it includes into one text, with #line directives that keep the real names, and writes it as a C array.
Loops of 2, 3, 4 or 8 turns are marked to be unrolled: PoCL's compiler leaves them, and with them what they index in memory.

usage: embed.py ROOT FILE NAME OUT.cl OUT.c     FILE and what it includes are relative to ROOT"""
import re
import sys

SHORT_LOOP = re.compile(r"for \(int (\w+) = 0; \1 < [2348]; \1\+\+\)")


def join(root, path, lines):
    lines.append(f'#line 1 "{path}"')
    with open(f"{root}/{path}") as file:
        for number, line in enumerate(file, 1):
            include = re.match(r'\s*#include "(.+)"', line)
            if include and "not for devices" not in line:
                join(root, include.group(1), lines)
                lines.append(f'#line {number + 1} "{path}"')
            elif not re.match(r"\s*#include", line):  # the rest is for C
                lines.append(SHORT_LOOP.sub(r'_Pragma("unroll") \g<0>', line.rstrip("\n")))


root, path, name, out_cl, out_c = sys.argv[1:]
lines = []
join(root, path, lines)
text = "\n".join(lines) + "\n"
with open(out_cl, "w") as file:
    file.write(text)
with open(out_c, "w") as file:
    data = text.encode("ascii") + b"\0"
    file.write(f"/* Made by render/opencl/embed.py from {path}. */\nextern const char {name}[];\nconst char {name}[] = {{\n")
    for i in range(0, len(data), 32):
        file.write(",".join(str(byte) for byte in data[i:i + 32]) + ",\n")
    file.write("};\n")
