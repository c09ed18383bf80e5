#!/usr/bin/python3
"""Reads a .dfield file into NumPy arrays: a second, independent reader of common/FORMAT.md.

    field = read_dfield.read('bunny.dfield')
    field['samples']            dense: array [z, y, x]; bricks: array [brick, z, y, x]; float32, decoded
    field['cells']              bricks: array [z, y, x] of brick indices, OUTSIDE or INSIDE
    field['divided']            adf: by family, a bit for each child that is divided; samples: array [family, z, y, x]

As a program: read_dfield.py FILE I J K prints one sample.
"""
import json
import struct
import sys

import numpy as np

OUTSIDE, INSIDE = 0xFFFFFFFF, 0xFFFFFFFE
TABLE = list(range(256))  # CRC-32C by bytes
for _ in range(8):
    TABLE = [crc >> 1 ^ (0x82F63B78 if crc & 1 else 0) for crc in TABLE]


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def read(path, verify=False):
    """verify=True also checks the checksums of the body; slow, as it is written in Python."""
    data = open(path, 'rb').read()
    if data[:8] != b'\x89DFIELD\n' or crc32c(data[:252]) != struct.unpack_from('<I', data, 252)[0]:
        raise ValueError(path + ': not a .dfield file, or its header is damaged')
    names = ('version endian_tag file_size section_count kind sample_type brick_size p q r verdict hx hy hz ox oy oz '
             'value_min value_max step_exponent block_count sample_count error_max error_rms level_count exact_count').split()
    head = dict(zip(names, struct.unpack_from('<IIQIIIIIIIIddddddffiIQddII', data, 8)))
    table = data[256:256 + 32 * head['section_count']]
    if crc32c(table) != struct.unpack_from('<I', data, 248)[0] or len(data) != head['file_size']:
        raise ValueError(path + ': the section table is damaged, or the file has the wrong size')
    sections = {}
    for tag, flags, offset, size, crc, reserved in struct.iter_unpack('<4sIQQII', table):
        sections[tag.decode()] = (offset, size)
    if verify:
        begin, block = (256 + len(table) + 63) // 64 * 64, 1 << 20
        end, size = sections['CRCS']
        for i, expected in enumerate(struct.unpack_from('<%dI' % (size // 4), data, end)):
            if crc32c(data[begin + i * block:min(begin + (i + 1) * block, end)]) != expected:
                raise ValueError('%s: block %d is damaged' % (path, i))

    def section(tag, dtype):
        offset, size = sections[tag]
        return np.frombuffer(data, dtype, size // np.dtype(dtype).itemsize, offset)

    dtype, zero = {1: ('<f4', 0), 2: ('<u2', 32768), 3: ('u1', 128)}[head['sample_type']]
    counts = (head['r'], head['q'], head['p'])
    head['provenance'] = json.loads(bytes(section('PROV', 'u1')))
    if head['kind'] == 1:
        samples = section('SAMP', dtype).reshape([n + 1 for n in counts])
    elif head['kind'] == 2:
        k = head['brick_size']
        head['cells'] = section('CELL', '<u4').reshape([-(-n // k) for n in counts])
        if zero:
            samples = unpack(section('PACK', 'u1'), head['cells'], section('STEP', 'i1').astype(int), k, zero)
        else:
            samples = section('SAMP', dtype).reshape(head['block_count'], k + 1, k + 1, k + 1)
    else:
        head['divided'] = section('FAMI', 'u1')
        floats = np.frombuffer(data, '<f4', 8 + 19 * head['exact_count'], sections['SAMP'][0])
        rest = section('SAMP', 'u1')[4 * floats.size:].view(dtype).reshape(-1, 19).astype(np.float32) - np.float32(zero)
        steps = np.ldexp(np.float32(1), section('STEP', 'i1').astype(np.int32)[:, None]) if zero else 1
        head['samples'] = octree_samples(floats[:8], floats[8:].reshape(-1, 19), rest * steps, head['divided'])
        return head
    exponents = head['step_exponent'] if head['kind'] == 1 else section('STEP', 'i1').reshape(-1, 1, 1, 1) if zero else 0
    head['samples'] = np.ldexp(samples.astype(np.float32) - np.float32(zero), np.int32(exponents)) if zero else samples
    return head


def unpack(packed, cells, exponents, k, zero):
    """The samples of bricks: some lie in earlier bricks, the others are rows of differences to what their neighbours foretell."""
    bits, at = np.unpackbits(packed, bitorder='little'), 0
    out = np.zeros((len(exponents), k + 1, k + 1, k + 1), np.int64)
    for cell in np.argwhere(cells < INSIDE):
        brick, known, box = cells[tuple(cell)], np.zeros((k + 1,) * 3, bool), np.zeros((k + 2,) * 3, np.int64)
        values = box[1:, 1:, 1:]  # the box has a border of zeros before them
        for direction in list(np.ndindex(3, 3, 3))[:13]:
            other = cell + direction - 1
            if (other < 0).any() or (other >= cells.shape).any() or cells[tuple(other)] >= INSIDE:
                continue
            other, faces = cells[tuple(other)], [slice(1), slice(None), slice(k, None)]
            ours, theirs = tuple(faces[d] for d in direction), tuple(faces[2 - d] for d in direction)
            values[ours], known[ours] = out[other][theirs] * 2.0 ** (exponents[other] - exponents[brick]), True
        for z, y in np.argwhere(~known.all(2)):
            width, at, row = bits[at:at + 4] @ (1, 2, 4, 8), at + 4, np.flatnonzero(~known[z, y])
            width += width == 15
            stored, at = bits[at:at + width * row.size].reshape(row.size, width) @ (1 << np.arange(width)), at + width * row.size
            stored -= stored >> max(width, 1) - 1 << width  # two's complement
            base, line, x = box[z + 1, y] + box[z, y + 1] - box[z, y], box[z + 1, y + 1], row[0]
            line[row + 1] = (base[row + 1] + line[x] - base[x] + np.cumsum(stored) + zero) % (2 * zero) - zero
        at, out[brick] = (at + 7) // 8 * 8, values
    return out + zero


def octree_samples(root, values, residuals, divided):
    """All 27 samples of each family: the first families' are stored, the others' are what they differ from means of corners."""
    family, child = np.nonzero(np.unpackbits(divided[:, None], axis=1, bitorder='little'))
    out, cell = np.empty((len(divided), 3, 3, 3), np.float32), root.reshape(2, 2, 2)
    inner = [i for i in range(27) if i not in (0, 2, 6, 8, 18, 20, 24, 26)]
    for f in range(len(divided)):
        if f:
            z, y, x = child[f - 1] >> 2, child[f - 1] >> 1 & 1, child[f - 1] & 1
            cell = out[family[f - 1], z:z + 2, y:y + 2, x:x + 2]
        for axis in (2, 1, 0):
            low, high = np.split(cell, 2, axis)
            cell = np.concatenate([low, (low + high) * np.float32(0.5), high], axis)
        exact = f < len(values)
        cell.reshape(27)[inner] = values[f] if exact else cell.reshape(27)[inner] + residuals[f - len(values)]
        out[f] = cell
    return out


def sample(field, i, j, k):
    """The value at sample (i,j,k): a number, or +-infinity in a cell without a brick. Not for adf."""
    if field['kind'] == 1:
        return field['samples'][k, j, i]
    size, cells, best = field['brick_size'], field['cells'], np.float32(np.nan)
    for di, dj, dk in np.ndindex(2, 2, 2):  # a shared sample lies in up to 8 bricks; one of them is enough
        cell = [(n - d) // size for n, d in ((k, dk), (j, dj), (i, di))]
        if any(c < 0 or c >= limit for c, limit in zip(cell, cells.shape)):
            continue
        brick = cells[tuple(cell)]
        if brick < INSIDE:
            return field['samples'][brick, k - cell[0] * size, j - cell[1] * size, i - cell[2] * size]
        best = np.float32(np.inf if brick == OUTSIDE else -np.inf)
    return best


if __name__ == '__main__':
    print(repr(float(sample(read(sys.argv[1]), *map(int, sys.argv[2:5])))))
