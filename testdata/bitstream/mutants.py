"""Whether the vectors catch mistakes: every mutant is decode.py with one mistake that the writer of a decoder might make,
and some vector must tell it from decode.py.

Usage: mutants.py FILE.tcgs...    (of both versions)
"""
import json, pathlib, sys, types

SOURCE = pathlib.Path(__file__).with_name('decode.py').read_text()

# What the mistake is, what decode.py says, what the mutant says.
MUTANTS = [
    # Models.
    ('age without a cap', 'rate = min(log2(self.age), 7)', 'rate = log2(self.age)'),
    ('age capped at 6', 'rate = min(log2(self.age), 7)', 'rate = min(log2(self.age), 6)'),
    ('age before it grows', 'rate = min(log2(self.age), 7)', 'rate = min(log2(max(self.age - 1, 1)), 7)'),
    ('shift towards zero', '(target - self.bound[i]) >> rate', 'int((target - self.bound[i]) / 2**rate)'),
    ('sixteen symbols for all', 'each = (2**30 - (16 - n) * 65536) // n', 'n = 16; each = (2**30 - (16 - n) * 65536) // n'),
    # Numbers and codes.
    ('exponent off by one', 'bits = 6 + min(', 'bits = 7 + min('),
    ('all bits of a number plain', 'top = min(bits, 3)\n', 'top = min(bits, 2)\n'),
    ('halves away from zero', 'nearest = lambda x: math.floor(x + 0.5)', 'nearest = lambda x: math.floor(abs(x) + 0.5) * (1 if x >= 0 else -1)'),
    ('halves to even', 'nearest = lambda x: math.floor(x + 0.5)', 'nearest = round'),
    ('size capped at 4', 'size = lambda z: min(log2(z + 1), 5)', 'size = lambda z: min(log2(z + 1), 4)'),
    ('size not capped', 'size = lambda z: min(log2(z + 1), 5)', 'size = lambda z: log2(z + 1)'),
    ('bucket capped at 4', 'min(log2(count + 1) + 1, 5)', 'min(log2(count + 1) + 1, 4)'),
    ('bucket not capped', 'min(log2(count + 1) + 1, 5)', 'log2(count + 1) + 1'),
    # Maps.
    ('widths of means beside quats', 'if a > 1 else 0', 'if a > 0 else 0'),
    ('widths begin anew in a layer', 'if g > 0 else 0', 'if g > layer.start else 0'),
    ('moves begin anew in a layer', 'if g >= k else 0', 'if g - layer.start >= k else 0'),
    ('the last decision is of any Gaussian', '            decision = 0\n', '            decision = 0 if g == 0 else decision\n'),
    ('symbols beyond two are capped', 'symbols.read(moving[a, c, one, two, decision]) % 2', 'min(symbols.read(moving[a, c, one, two, decision]), 1)'),
    # First positions.
    ('symbols beyond four are capped', 'symbols.read(low[top]) % 4', 'min(symbols.read(low[top]), 3)'),
    ('symbols beyond eight are capped', 'symbols.read(leading[bits]) % 2**modelled', 'min(symbols.read(leading[bits]), 2**modelled - 1)'),
    ('the next key builds on the key without its dropped bits', '            b = self.width[MEANS][g]\n            axes', '            b = self.width[MEANS][g]; key = key >> 3 * (widest - b) << 3 * (widest - b)\n            axes'),
    ('the key goes on from layer to layer', 'widest, key = max(self.plan[\'quantizers\'][MEANS]), 0', 'widest, key = max(self.plan[\'quantizers\'][MEANS]), getattr(self, "key", 0)', 'key = (key + gap)', 'key = self.key = (key + gap)'),
    ('the last gap begins anew in a layer', 'widest, key = max', 'self.gap_before = 0; widest, key = max'),
    ('the shorter run of plain bits first', 'count = min(rest, 15)', 'count = rest % 15 or 15'),
    # Neighbours.
    ('tied candidates: the later first', 'sorted(candidates, key=distance)[:2]', 'sorted(candidates[::-1], key=distance)[:2]'),
    ('tied candidates: the lower index first', 'sorted(candidates, key=distance)[:2]', 'sorted(sorted(candidates), key=distance)[:2]'),
    ('candidates oldest first', 'range(g - 1, g - 5, -1) if h >= layer.start', 'range(g - 4, g) if h >= layer.start'),
    ('candidates beyond the layer', 'if h >= layer.start]', 'if h >= 0]'),
    ('equal curve keys count as below', 'bisect.bisect_left(self.curve, (key, -1))', 'bisect.bisect_left(self.curve, (key, 1 << 40))'),
    ('equal curve keys by descending index', 'self.curve = sorted(self.curve + own)', 'self.curve = sorted(self.curve + own, key=lambda k: (k[0], -k[1]))'),
    ('five candidates along the curve', 'max(place - 4, 0):place + 4]', 'max(place - 5, 0):place + 5]'),
    ('the own layer is on the curve', 'candidates += [h for', 'candidates += [h for _, h in own if h < g] + [h for'),
    ('points not aligned', '<< (16 - b) for code', '<< 0 for code'),
    ('distances along axes', '(x - y)**2 for', 'abs(x - y) for'),
    # First codes.
    ('a missing second neighbour is zero', 'two = (self.neighbors[g] * 2)[:2]', 'two = self.neighbors[g]', 'near = near or [[0.0] * count] * 2', 'near = (near + [[0.0] * count] * 2)[:2]'),
    ('the neighbour\'s code by the own quantizer', '[self.value(a, h, c, self.code[a][h][c]) for', '[self.value(a, g, c, self.code[a][h][c]) for'),
    ('predictions not clamped', 'code_of = lambda x: clamp(nearest((x - offset) / step), -2**(b - 1), 2**(b - 1) - 1)', 'code_of = lambda x: nearest((x - offset) / step)'),
    ('only predictions of mode 1 not clamped', 'code = wrap(code_of(prediction) +', 'code = wrap(nearest((prediction - offset) / step) +'),
    ('spread not capped', 'min(log2(apart) + 1, 7)', 'log2(apart) + 1'),
    ('rest of means beyond length', 'math.sqrt(max(rest, 0.0))', 'math.sqrt(abs(rest))'),
    ('mode 2 as mode 0', 'prediction if mode == 0 else', 'prediction if mode != 1 else'),
    ('middle model by component alone', 'middle[c, b, v]', 'middle[c, v]'),
    ('features of codes', 'before.append(value)', 'before.append(code)'),
    # Segments.
    ('each unit of a Gaussian has the neighbour of the first', 'if (h, c0) in self.units), NONE)', 'if (h, 0) in self.units), NONE)', 'self.units[neighbor, c0]', 'self.units.get((neighbor, c0), ([], []))'),
    ('only the first neighbour', 'for h in self.shared.neighbors[g] if', 'for h in self.shared.neighbors[g][:1] if'),
    ('counts in one context', 'self.counts[c0, bucket(near), bucket(inner_before)]', 'self.counts[0, bucket(near), bucket(inner_before)]'),
    ('keypoints of the neighbour with their ends', 'max(len(self.units[neighbor, c0][0]) - 2, 0)', 'len(self.units[neighbor, c0][0])'),
    ('the count before goes on from layer to layer', 'inner_before = 0\n', 'inner_before = getattr(self, "last_count", 0)\n', 'inner_before = self.read_unit(', 'inner_before = self.last_count = self.read_unit('),
    ('k = 15 alone', 'inner = 14 + self.more', 'inner = 15 + self.more'),
    ('density not capped', 'min(log2(2 * free // left), 8) - 1', 'log2(2 * free // left) - 1'),
    ('a gap is read where none is free', 'if free > left else 0', 'if free >= left else 0'),
    ('the last keypoint is at Z', 'if Z < D else 0', 'if Z + 1 < D else 0'),
    ('k = 0 codes its last codes', 'if k == 0: codes.append', 'if k == 99: codes.append'),
    ('first codes without the neighbour', 'shift = self.scaled(g, neighbor, c, moved)', 'pass'),
    ('first codes by the neighbour\'s start', '- self.shared.code[a][neighbor][c]', '- self.at(neighbor, components[0], c, 0)'),
    ('sizes of first codes begin anew', '                last_size = size(z)\n', '                last_size = 0\n'),
    ('codes of the neighbour not scaled', 'if self.shared.width[self.a][g] == self.shared.width[self.a][h]: return difference', 'return difference'),
    ('steps the wrong way round', 'self.shared.quantizer(self.a, h, c)[0] / self.shared.quantizer(self.a, g, c)[0]', 'self.shared.quantizer(self.a, g, c)[0] / self.shared.quantizer(self.a, h, c)[0]'),
    ('shifts of first codes not clamped', 'code = wrap(code + clamp(nearest(shift), -SHIFT_LIMIT, SHIFT_LIMIT)', 'code = wrap(code + nearest(shift)'),
    ('shifts of later codes not clamped', 'row.append(wrap(u + clamp(nearest(shift), -SHIFT_LIMIT, SHIFT_LIMIT)', 'row.append(wrap(u + nearest(shift)'),
    ('the size of the last component before', 'if i > 0 else sizes[0]', 'if i > 0 else sizes[-1]'),
    ('the size of the same component', 'sizes[i - 1] if i > 0 else sizes[0]', 'sizes[i]'),
    ('times apart not capped', 'age = min(log2(times[j] - times[j - 1]), 3)', 'age = log2(times[j] - times[j - 1])'),
    ('with and without a neighbour alike', 'age, neighbor is not NONE)', 'age, False)'),
    ('motion 1 without the neighbour', 'return 0.0 if along is None else along', 'return 0.0'),
    ('motion 2 without its line', 'if motion == 2: return 0.0 if line is None else line', 'if motion == 2: return 0.0'),
    ('lines per keypoint', '(times[j] - times[j - 1]) / (times[j - 1] - times[j - 2])', '1.0'),
    ('motion 3 the sum', '(along + line) * 0.5', '(along + line)'),
    ('motion 3 of the line alone', 'if along is None: return 0.0 if line is None else line', 'if along is None: return 0.0'),
    ('motion 3 of the neighbour alone', 'return along if line is None else', 'return 0.0 if line is None else'),
    ('the neighbour is extrapolated', 'if after in (0, len(times)): return float(codes[max(after - 1, 0)][c - c0])', 'if after in (0, len(times)) and len(times) < 2: return float(codes[max(after - 1, 0)][c - c0])\n        after = clamp(after, 1, len(times) - 1)'),
    ('one segment if nothing varies', 'segment_length if moves else num_timesteps', 'segment_length'),
    # Reconstruction.
    ('binary64 throughout', 'return f32(v + f32(f32(value(k + 1) - v) * along))', 'return f32(v + (value(k + 1) - v) * along)'),
    ('weights of both ends', 'return f32(v + f32(f32(value(k + 1) - v) * along))', 'return f32(f32(v * f32(1 - along)) + f32(value(k + 1) * along))'),
    ('codes are interpolated', 'return f32(v + f32(f32(value(k + 1) - v) * along))', 'return f32(self.shared.value(a, g, c, codes[k] + (codes[k + 1] - codes[k]) * along))'),
    ('overflow is the largest', 'return math.copysign(math.inf, x)', 'return math.copysign(3.4028234663852886e38, x)'),
    ('quaternions as they are', 'rows = [unit(row) for row in rows]', 'pass'),
    ('no quaternion that has no length', 'if squares(quat) > 0.5 else [1.0, 0.0, 0.0, 0.0]', ''),
    ('keypoints are normalised', 'value = lambda k: f32(', 'value = lambda k: unit([f32(self.shared.value(a, i // 4, j, self.tracks[a][i // 4 * 4 + j][1][k])) for j in range(4)])[i % 4] if a == QUATS and self.shared.plan["joint"][a] and self.shared.moves[a][i // 4][0] else f32('),
    # Container.
    ('optional sections in the way', 'for entry in entries if not entry[5]]', 'for entry in entries]'),
    ('optional sections in the way, version 2', '[entry for entry in entries if not entry[4]]', 'entries'),
    ('lower-case letters alone are optional', 'optional = tag[0] & 0x20 != 0', 'optional = 97 <= tag[0] <= 122'),
    # Version 2: lives.
    ('lives count from the birth', 'return birth, self.last - left', 'return birth, birth + left'),
    ('ends of lives in one context', 'self.left.read(symbols, birth > 0)', 'self.left.read(symbols, 0)'),
    ('births and deaths in one model', 'self.left.read(symbols,', 'self.births.read(symbols,'),
    ('segments of Gaussians that do not live yet', 'max(self.first, B), min(self.last, D)', 'self.first, min(self.last, D)'),
    ('segments of Gaussians that live no more', 'max(self.first, B), min(self.last, D)', 'max(self.first, B), self.last'),
    ('a birth within a segment is none', 'if A > B else 0', 'if A > 0 else 0'),
    ('a death within a segment is none', 'if Z < D else 0', 'if Z < self.shared.last else 0'),
    ('first codes are of timestep 0', 'A - before, A == B)', 'A - before, A == 0)'),
    ('a neighbour that does not live is one', 'if (h, c0) in self.units), NONE)', 'if self.shared.moves[a][h][c0]), NONE)', 'self.units[neighbor, c0]', 'self.units.get((neighbor, c0), ([0], [self.shared.code[a][neighbor]]))', 'times, codes = self.units[h, c0]', 'times, codes = self.units.get((h, c0), ([0], [self.shared.code[self.a][h]]))'),
    ('what does not live has no inner keypoint', 'if B > self.last or D < self.first: continue', 'if B > self.last or D < self.first: inner_before = 0; continue'),
    ('all live always', 'if B <= now <= D]', 'if True]'),
    ('the last timestep of a life is not of it', 'if B <= now <= D]', 'if B <= now < max(D, B + 1)]'),
    ('a track in one timestep has its time', '(times if len(times) > 1 else [0], codes)', '(times, codes)'),
    # Version 2: attributes.
    ('what is lacking has a width', 'present[a, before > 0, there]', 'present[a, True, there]'),
    ('each decision alone', 'present[a, before > 0, there]', 'present[a, before > 0, 0]'),
    ('the decision before is of any Gaussian', '            there = 0\n', '            there = 0 if g == layer[0] else there\n'),
    ('symbols beyond two are capped, of what is there', 'present[a, before > 0, there]) % 2', 'present[a, before > 0, there]) > 0'),
    ('models of what is there in common', 'present[a, before', 'present[0, before'),
    ('decisions of what is lacking', "if self.plan['varies'][a] and self.width[a][g] > 0 else 0", "if self.plan['varies'][a] else 0"),
    ('neighbours that lack it are passed over', 'two = (self.neighbors[g] * 2)[:2]', 'two = ([h for h in self.neighbors[g] if self.width[a][h] > 0] * 2)[:2]'),
    ('all features for all', 'if a >= BASE: features = [1.0, near[0][c], near[1][c]] + before[-3:]', ''),
    ('the latest component first', '+ before[-3:]', '+ before[:-4:-1]'),
    ('the first three components', '+ before[-3:]', '+ before[:3]'),
    ('all components before', '+ before[-3:]', '+ before'),
    ('what is lacking has the value of code 0', 'if self.width[a][g] == 0: return 0.0', 'if self.width[a][g] == 0: return self.plan["quantizers"][a][min(self.plan["quantizers"][a])][c][1]'),
    ('unit length of all that is normalised', 'if a == QUATS: rows', 'if self.head.plan["activations"][a] == 1: rows'),
    ('what is skipped has no sections', "[s for s in found if s[0] is not None or checked(s) is None]", 'found'),
    ('what is skipped makes no segments', "any(varies for _, varies in plan['listed'])", 'len(self.varying) > 0'),
    ('what is skipped has no sections in segments', "[name for name, varies in self.plan['listed'] if varies]", "[name for name, varies in self.plan['listed'] if varies and name]"),
    ('what is skipped has no length', "f.take(f.u(4, 'length of an attribute'), 'length of an attribute')", "f.u(4, 'length of an attribute')"),
    ('no coding is skipped', 'optional and place >= BASE', 'False'),
    # Version 2: cohorts.
    ('times count from the start of the scene', 'now = t - self.head.start', 'now = t'),
    ('models of the cohort whose plan is shared', 'shared = Shared(plan, head.num_timesteps, head.has_lives)', 'shared = Shared(plan, head.num_timesteps, head.has_lives); shared.maps = plan.setdefault("maps", shared.maps)'),
    ('a plan for every cohort', 'plan = plan or read_plan_2(f)', 'plan = read_plan_2(f)'),
    ('the plan of the cohort before', "cohorts[place['plan']].plan if place['plan'] < len(cohorts)", "cohorts[-1].plan if place['plan'] < len(cohorts)"),
    ('the cohort that begins last comes first', 'parts = [cohort.at(t) for cohort in self.cohorts]', 'parts = [cohort.at(t) for cohort in self.cohorts[::-1]]'),
    ('checksum of the whole header', 'zlib.crc32(data[:16] + data[20:end])', 'zlib.crc32(data[:end])'),
    ('segments without offsets', "start = f.u(8, 'offset of a segment')", "start = end + 0 * f.u(8, 'offset of a segment')"),
]

def decoder(source):
    module = types.ModuleType('mutant')
    exec(compile(source, 'decode.py', 'exec'), module.__dict__)
    return module

def differs(module, data, expected):
    """Whether a decoder fails on a file or finds other values in it."""
    try: return next(module.differences(module.decode(data), expected), None) is not None
    except Exception: return True

def main(paths):
    # The small ones first.
    vectors = sorted(((pathlib.Path(p).read_bytes(), p) for p in paths), key=lambda v: len(v[0]))
    expected = {path: json.loads(pathlib.Path(path).with_suffix('.json').read_text()) for _, path in vectors}
    original, alive = decoder(SOURCE), []
    for data, path in vectors:
        if differs(original, data, expected[path]): sys.exit(f'{path}: decode.py itself differs')
    for mistake, *changes in MUTANTS:
        source = SOURCE
        for before, after in zip(changes[::2], changes[1::2]):
            if before not in source: sys.exit(f'{mistake}: decode.py does not say {before!r}')
            source = source.replace(before, after)
        mutant = decoder(source)
        by = next((path for data, path in vectors if differs(mutant, data, expected[path])), None)
        if by is None: alive.append(mistake)
        print(f'{pathlib.Path(by).stem if by else "CAUGHT BY NONE":>24}  {mistake}')
    if alive: sys.exit(f'{len(alive)} of {len(MUTANTS)} mistakes pass all vectors')
    print(f'all {len(MUTANTS)} mistakes are caught')

if __name__ == '__main__': main(sys.argv[1:])
