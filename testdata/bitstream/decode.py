"""A decoder of .tcgs version 1, written from docs/FORMAT.md; it shares no code with the Rust one. Slow and complete: it
checks the text, and it is the reference of scripts/conformance.py.

Usage:
  decode.py FILE.tcgs OUT             write all floats of a file, as docs/FORMAT.md says under "Conformance"
  decode.py --check FILE.tcgs...      compare each file with the values that it means, in the FILE.json beside it
"""
import bisect, json, math, struct, sys, zlib

NAMES = ['means', 'quats', 'log_scales', 'logit_opacities', 'colors']
TAGS = [b'MEAN', b'QUAT', b'SCAL', b'OPAC', b'COLR']
COMPONENTS = [3, 4, 3, 1, 3]
MEANS, QUATS = 0, 1
SHARED = 65535
NONE = None
SHIFT_LIMIT = 10**6

class Refused(Exception):
    """The file must be refused. Section and field have the names that the Rust decoder gives them."""
    def __init__(self, section, field, problem):
        super().__init__(f'{section}: {field}: {problem}')
        self.section, self.field = section, field

def must(holds, section, field, problem):
    if not holds: raise Refused(section, field, problem)

def f32(x):
    """The nearest binary32; infinity beyond the largest."""
    try: return struct.unpack('<f', struct.pack('<f', x))[0]
    except OverflowError: return math.copysign(math.inf, x)

log2 = lambda n: n.bit_length() - 1
nearest = lambda x: math.floor(x + 0.5)
clamp = lambda x, low, high: max(low, min(high, x))
wrap = lambda x, b: (x + 2**(b - 1)) % 2**b - 2**(b - 1)
signed = lambda z: z // 2 if z % 2 == 0 else -(z + 1) // 2
size = lambda z: min(log2(z + 1), 5)
bucket = lambda count: 0 if count == 0 else min(log2(count + 1) + 1, 5)

# --- Container ---------------------------------------------------------------------------------------------------------

class Fields:
    """The fields of a section, one after another."""
    def __init__(self, data, section): self.data, self.section, self.at = data, section, 0
    def take(self, n, field):
        must(self.at + n <= len(self.data), self.section, field, 'reaches past the end')
        self.at += n
        return self.data[self.at - n:self.at]
    def u(self, n, field): return int.from_bytes(self.take(n, field), 'little')
    def f(self, field): return struct.unpack('<f', self.take(4, field))[0]
    def text(self, field):
        data = self.take(self.u(2, field), field)
        try: return data.decode('utf-8')
        except UnicodeDecodeError: raise Refused(self.section, field, 'not UTF-8')
    def flags(self, field):
        byte = self.u(1, field)
        must(byte < 32, self.section, field, 'more attributes than there are')
        return [byte >> a & 1 == 1 for a in range(5)]
    def end(self): must(self.at == len(self.data), self.section, 'end', 'bytes are left over')

def section_name(tag):
    known = {b'INFO': 'info', b'PLAN': 'plan', b'MAPS': 'maps', b'appl': 'application data'} | dict(zip(TAGS, NAMES))
    return known.get(tag, 'unknown section')

def read_container(data):
    """The sections that are not optional, each (tag, segment, layer, bytes)."""
    must(data[:4] == b'TCGS'[:len(data)], 'header', 'magic', 'this is not a .tcgs file')
    must(len(data) >= 16, 'file', 'end', 'the file ends early')
    top = Fields(data, 'header')
    top.take(4, 'magic')
    must(top.u(2, 'version') == 1, 'version', 'version', 'another version')
    must(top.u(2, 'reserved') == 0, 'header', 'reserved', 'not zero')
    count = top.u(4, 'number of sections')
    must(count <= 2**20, 'header', 'number of sections', 'more than 1048576')
    must(len(data) >= 16 + 16 * count, 'file', 'end', 'the file ends early')
    crc = zlib.crc32(data[:12] + data[16:16 + 16 * count])
    must(top.u(4, 'checksum') == crc, 'header', 'checksum', 'the header is damaged')
    entries, at = [], 16 + 16 * count
    for _ in range(count):
        tag, segment, layer = top.take(4, 'tag'), top.u(2, 'segment'), top.u(2, 'layer')
        length, crc = top.u(4, 'length'), top.u(4, 'checksum')
        optional = tag[0] & 0x20 != 0
        must(optional or section_name(tag) != 'unknown section', 'header', 'tag', 'may not be skipped')
        entries.append((tag, segment, layer, data[at:at + length], crc, optional))
        at += length
    must(at <= len(data), 'file', 'end', 'the file ends early')
    must(at == len(data), 'file', 'end', 'bytes are left over')
    for tag, _, _, body, crc, _ in entries:
        must(zlib.crc32(body) == crc, section_name(tag), 'checksum', 'the section is damaged')
    return [entry[:4] for entry in entries if not entry[5]]

def read_info(f):
    s = {'num_gaussians': f.u(4, 'num_gaussians'), 'num_timesteps': f.u(4, 'num_timesteps')}
    # This decoder's own limits.
    must(s['num_gaussians'] <= 2**24 and s['num_timesteps'] <= 2**16, 'limit', 'limit', 'more than this decoder takes')
    s |= {'first_frame': f.u(4, 'first_frame'), 'downscale': f.u(4, 'downscale'), 'frame_rate': f.f('frame_rate')}
    bounds = [f.f('bounds') for _ in range(6)]
    ascending = all(low <= high for low, high in zip(bounds[:3], bounds[3:]))
    must(all(map(math.isfinite, bounds)) and ascending, 'info', 'bounds', 'not finite or not ascending')
    s['color_space'] = f.u(1, 'color_space')
    must(s['color_space'] <= 1, 'info', 'color_space', 'unknown')
    s['up'] = f.u(1, 'up')
    must(s['up'] <= 6, 'info', 'up', 'unknown')
    s |= {'name': f.text('name'), 'generator': f.text('generator'), 'segment_length': f.u(4, 'segment_length')}
    s['layers'] = [f.u(4, 'layers') for _ in range(f.u(2, 'number of layers'))]
    must(1 <= s['num_timesteps'] <= 65536, 'info', 'num_timesteps', 'not within 1 to 65536')
    must(math.isfinite(s['frame_rate']) and s['frame_rate'] >= 0, 'info', 'frame_rate', 'negative or not finite')
    must(s['downscale'] >= 1, 'info', 'downscale', 'zero')
    must(sum(s['layers']) == s['num_gaussians'], 'info', 'layers', 'not as many Gaussians as the scene')
    must(0 not in s['layers'], 'info', 'layers', 'an empty one')
    must(1 <= s['segment_length'] <= 65536, 'info', 'segment_length', 'not within 1 to 65536')
    f.end()
    return s

def read_plan(f):
    plan = {'varies': f.flags('varying attributes'), 'joint': f.flags('joint attributes'), 'quantizers': [], 'predictors': []}
    for a in range(5):
        must(f.u(1, 'interpolation') == 0, 'plan', 'interpolation', 'unknown')
        quantizers = {}
        for _ in range(f.u(1, 'number of widths')):
            b = f.u(1, 'width')
            must(b > max(quantizers, default=-1), 'plan', 'width', 'not ascending')
            quantizers[b] = [(f.f('step'), f.f('offset')) for _ in range(COMPONENTS[a])]
            for step, offset in quantizers[b]:
                legal = 1 <= b <= 16 and 0 < step < math.inf and math.isfinite(offset)
                must(legal, 'plan', 'quantizer', 'not 1 to 16 bits, or not finite, or a step that is not positive')
        predictors = []
        for c in range(COMPONENTS[a] if a != MEANS else 0):
            mode = f.u(1, 'mode')
            must(mode <= 2, 'plan', 'mode', 'unknown')
            weights = [f.f('weight') for _ in range(1 + 2 * COMPONENTS[a] + c)]
            must(all(map(math.isfinite, weights)), 'plan', 'weight', 'not finite')
            predictors.append((mode, weights))
        plan['quantizers'].append(quantizers)
        plan['predictors'].append(predictors)
    f.end()
    return plan

# --- Symbols -----------------------------------------------------------------------------------------------------------

class Model:
    def __init__(self, n):
        each = (2**30 - (16 - n) * 65536) // n
        self.bound = [i * each if i < n else 2**30 - (16 - i) * 65536 for i in range(16)] + [2**30]
        self.age = 1
    def interval(self, symbol):
        start = self.bound[symbol] >> 15
        return start, (self.bound[symbol + 1] >> 15) - start
    def learn(self, symbol):
        self.age += 1
        rate = min(log2(self.age), 7)
        for i in range(1, 16):
            target = 65536 * i if i <= symbol else 2**30 - (16 - i) * 65536
            self.bound[i] += (target - self.bound[i]) >> rate

class Models(dict):
    """A model for every context, made when it is first used."""
    def __init__(self, n, name): self.n, self.name = n, name
    def __missing__(self, context):
        model = self[context] = Model(self.n(context) if callable(self.n) else self.n)
        model.name = self.name
        return model

class Symbols:
    """The symbols of a section."""
    def __init__(self, data, section):
        self.data, self.section, self.at = data, section, 8
        self.x = int.from_bytes(data[:8], 'little')
        self.must(len(data) >= 8 and 2**31 <= self.x < 2**63)
    def must(self, holds): must(holds, self.section, 'symbols', 'not exactly as many as there should be')
    def step(self, start, length):
        self.x = length * (self.x >> 15) + self.x % 2**15 - start
        if self.x < 2**31:
            self.must(self.at + 4 <= len(self.data))
            self.x = self.x * 2**32 + int.from_bytes(self.data[self.at:self.at + 4], 'little')
            self.at += 4
    def read(self, model):
        # The last that starts at or below the slot: those whose bounds, rounded down, are not above.
        symbol = bisect.bisect_right(model.bound, self.x % 2**15 * 2**15 + 2**15 - 1, 0, 16) - 1
        self.step(*model.interval(symbol))
        model.learn(symbol)
        return symbol
    def bits(self, count):
        if count == 0: return 0
        value = self.x % 2**15 >> (15 - count)
        self.step(value << (15 - count), 1 << (15 - count))
        return value
    def end(self): self.must(self.x == 2**31 and self.at == len(self.data))

class Numbers:
    def __init__(self, name):
        self.symbol, self.exponent = Models(16, name), Models(10, name + ' exponent')
        self.leading = Models(lambda bits: 2**min(bits, 3), name + ' leading')
    def read(self, symbols, context):
        u = symbols.read(self.symbol[context])
        if u < 8: return u
        if u < 14:
            bits = u // 2 - 2
            base = (2 + u % 2) << bits
        else:
            bits = 6 + min(symbols.read(self.exponent[0]), 9)
            base = 2**bits
        top = min(bits, 3)
        high = symbols.read(self.leading[bits]) % 2**top
        return base + (high << (bits - top)) + symbols.bits(bits - top)

# --- Shared layers -----------------------------------------------------------------------------------------------------

def curve_key(point, bits):
    return sum((point[c] >> j & 1) << (3 * j + c) for j in range(bits) for c in range(3))

class Shared:
    """What all segments share: widths, which tracks move, first codes, neighbours."""
    def __init__(self, plan):
        self.plan = plan
        self.width, self.moves, self.code = ([[] for _ in range(5)] for _ in range(3))
        self.neighbors, self.points, self.curve = [], [], []
        self.maps = Models(16, 'width'), Models(2, 'moves')
        self.curve_models = Models(13, 'gap high'), Models(4, 'gap low'), Models(8, 'gap leading')
        self.gap_before = 0
        self.first = [(Models(16, 'high'), Models(16, 'middle'), Numbers('difference')) for _ in range(5)]

    def quantizer(self, a, g, c): return self.plan['quantizers'][a][self.width[a][g]][c]
    def value(self, a, g, c, code):
        step, offset = self.quantizer(a, g, c)
        return code * step + offset

    def read_maps(self, symbols, layer):
        widths, moving = self.maps
        for g in layer:
            for a in range(5):
                before = self.width[a][g - 1] if g > 0 else 0
                left = self.width[a - 1][g] if a > 1 else 0
                self.width[a].append(1 + symbols.read(widths[a, before, left]))
            decision = 0
            for a in range(5):
                row = [0] * COMPONENTS[a]
                for c in range(COMPONENTS[a] if self.plan['varies'][a] else 0):
                    if self.plan['joint'][a] and c > 0:
                        row[c] = row[0]
                        continue
                    one, two = (self.moves[a][g - k][c] if g >= k else 0 for k in (1, 2))
                    decision = row[c] = symbols.read(moving[a, c, one, two, decision]) % 2
                self.moves[a].append(row)
        symbols.end()
        for a in range(5):
            known = all(self.width[a][g] in self.plan['quantizers'][a] for g in layer)
            must(known, 'maps', 'bit widths', 'a width without quantizers')

    def read_positions(self, symbols, layer):
        high, low, leading = self.curve_models
        widest, key = max(self.plan['quantizers'][MEANS]), 0
        for g in layer:
            top = min(symbols.read(high[self.gap_before // 4]), 12)
            bits = min(4 * top + symbols.read(low[top]) % 4, 48)
            self.gap_before = gap = bits
            if bits >= 2:
                modelled = min(bits - 1, 3)
                gap = 2**modelled + symbols.read(leading[bits]) % 2**modelled
                rest = bits - 1 - modelled
                while rest > 0:
                    count = min(rest, 15)
                    gap = gap << count | symbols.bits(count)
                    rest -= count
            key = (key + gap) % 2**(3 * widest)
            b = self.width[MEANS][g]
            axes = [sum((key >> (3 * j + c) & 1) << j for j in range(widest)) for c in range(3)]
            self.code[MEANS].append([(x >> (widest - b)) - 2**(b - 1) for x in axes])
        symbols.end()

    def find_neighbors(self, layer):
        own = []
        for g in layer:
            b = self.width[MEANS][g]
            self.points.append([(code + 2**(b - 1)) << (16 - b) for code in self.code[MEANS][g]])
            own.append((curve_key(self.points[g], 16), g))
        for key, g in own:
            place = bisect.bisect_left(self.curve, (key, -1))
            candidates = [h for h in range(g - 1, g - 5, -1) if h >= layer.start]
            candidates += [h for _, h in self.curve[max(place - 4, 0):place + 4]]
            distance = lambda h: sum((x - y)**2 for x, y in zip(self.points[g], self.points[h]))
            self.neighbors.append(sorted(candidates, key=distance)[:2])
        self.curve = sorted(self.curve + own)

    def read_first_codes(self, a, symbols, layer):
        high, middle, numbers = self.first[a]
        for g in layer:
            b, codes = self.width[a][g], []
            self.code[a].append(codes)
            two = (self.neighbors[g] * 2)[:2]
            near = [[self.value(a, h, c, self.code[a][h][c]) for c in range(COMPONENTS[a])] for h in two]
            near = near or [[0.0] * COMPONENTS[a]] * 2
            features, rest = [1.0] + near[0] + near[1], 1.0
            for c in range(COMPONENTS[a]):
                (step, offset), (mode, weights) = self.quantizer(a, g, c), self.plan['predictors'][a][c]
                code_of = lambda x: clamp(nearest((x - offset) / step), -2**(b - 1), 2**(b - 1) - 1)
                prediction = 0.0
                for x, weight in zip(features, weights): prediction += x * weight
                if mode == 1:
                    apart = abs(code_of(near[0][c]) - code_of(near[1][c]))
                    spread = 0 if apart == 0 else min(log2(apart) + 1, 7)
                    code = wrap(code_of(prediction) + signed(numbers.read(symbols, (c, b, spread))), b)
                else:
                    expected = code_of(prediction if mode == 0 else math.sqrt(max(rest, 0.0)))
                    bin = (expected + 2**(b - 1)) * 16 >> b
                    top = min(b, 4)
                    mid = min(b - top, 4)
                    v = symbols.read(high[c, b, bin]) % 2**top
                    code = v
                    if mid > 0: code = code << mid | symbols.read(middle[c, b, v]) % 2**mid
                    code = (code << (b - top - mid) | symbols.bits(b - top - mid)) - 2**(b - 1)
                codes.append(code)
                value = self.value(a, g, c, code)
                rest -= value * value
                features.append(value)
        symbols.end()

# --- Segments ----------------------------------------------------------------------------------------------------------

class SegmentOf:
    """The keypoints of one attribute within one segment: (times, codes[keypoint][component]) by Gaussian and unit."""
    def __init__(self, a, shared, first, last, num_timesteps):
        self.a, self.shared, self.first, self.last, self.num_timesteps = a, shared, first, last, num_timesteps
        self.joint = shared.plan['joint'][a]
        self.units = {}
        self.counts = Models(16, 'count')
        names = 'more', 'before', 'after', 'gap', 'first', 'later'
        self.more, self.before, self.after, self.gaps, self.firsts, self.laters = map(Numbers, names)

    def read_layer(self, symbols, layer, motion):
        inner_before, per = 0, COMPONENTS[self.a] if self.joint else 1
        for g in layer:
            for c0 in range(0, COMPONENTS[self.a], per):
                if self.shared.moves[self.a][g][c0]:
                    inner_before = self.read_unit(symbols, motion, g, range(c0, c0 + per), inner_before)
        symbols.end()

    def read_unit(self, symbols, motion, g, components, inner_before):
        a, A, Z, T, c0 = self.a, self.first, self.last, self.num_timesteps, components[0]
        late = lambda holds: must(holds, NAMES[a], 'keypoint times', 'not within the timesteps that are left')
        neighbor = next((h for h in self.shared.neighbors[g] if self.shared.moves[a][h][c0]), NONE)
        b = self.shared.width[a][g]
        before = self.before.read(symbols, 0) if A > 0 else 0
        late(before <= A)
        times, codes = [A - before], [self.read_start(symbols, g, components, neighbor, A - before)]
        self.units[g, c0] = times, codes
        if A == Z and before == 0: return 0
        near = 0 if neighbor is NONE else max(len(self.units[neighbor, c0][0]) - 2, 0)
        k = symbols.read(self.counts[c0, bucket(near), bucket(inner_before)])
        inner = max(k - 1, 0)
        if k == 15: inner = 14 + self.more.read(symbols, 0)
        t, free = A, max(Z - A - 1, 0)
        late(inner <= free)
        for left in range(inner, 0, -1):
            gap = self.gaps.read(symbols, min(log2(2 * free // left), 8) - 1) if free > left else 0
            late(gap <= free - left)
            t, free = t + gap + 1, free - gap - 1
            times.append(t)
        times.append(Z + (self.after.read(symbols, 0) if Z + 1 < T else 0))
        late(times[-1] < T)
        if k == 0: codes.append(codes[0])
        else: self.read_later(symbols, motion, g, components, neighbor)
        return inner

    def read_start(self, symbols, g, components, neighbor, time):
        a, codes, last_size = self.a, [], 0
        for c in components:
            code, b = self.shared.code[a][g][c], self.shared.width[a][g]
            if self.first > 0:
                shift = 0.0
                if neighbor is not NONE:
                    moved = self.at(neighbor, components[0], c, time) - self.shared.code[a][neighbor][c]
                    shift = self.scaled(g, neighbor, c, moved)
                z = self.firsts.read(symbols, (c, b, last_size))
                last_size = size(z)
                code = wrap(code + clamp(nearest(shift), -SHIFT_LIMIT, SHIFT_LIMIT) + signed(z), b)
            codes.append(code)
        return codes

    def read_later(self, symbols, motion, g, components, neighbor):
        times, codes = self.units[g, components[0]]
        b, sizes = self.shared.width[self.a][g], [0] * len(components)
        for j in range(1, len(times)):
            row = []
            for i, c in enumerate(components):
                u = codes[j - 1][i]
                along = line = None
                if neighbor is not NONE:
                    ends = (self.at(neighbor, components[0], c, t) for t in (times[j], times[j - 1]))
                    along = self.scaled(g, neighbor, c, next(ends) - next(ends))
                if j > 1:
                    line = float(u - codes[j - 2][i]) * (times[j] - times[j - 1]) / (times[j - 1] - times[j - 2])
                shift = self.shift(motion, along, line)
                age = min(log2(times[j] - times[j - 1]), 3)
                last_size = sizes[i - 1] if i > 0 else sizes[0]
                z = self.laters.read(symbols, (c, b, last_size, age, neighbor is not NONE))
                sizes[i] = size(z)
                row.append(wrap(u + clamp(nearest(shift), -SHIFT_LIMIT, SHIFT_LIMIT) + signed(z), b))
            codes.append(row)

    @staticmethod
    def shift(motion, along, line):
        if motion == 1: return 0.0 if along is None else along
        if motion == 2: return 0.0 if line is None else line
        if motion == 3:
            if along is None: return 0.0 if line is None else line
            return along if line is None else (along + line) * 0.5
        return 0.0

    def at(self, h, c0, c, time):
        """Code of a component of a unit of this segment at a time."""
        times, codes = self.units[h, c0]
        after = bisect.bisect_right(times, time)
        if after in (0, len(times)): return float(codes[max(after - 1, 0)][c - c0])
        (ta, tb), (u, v) = times[after - 1:after + 1], (float(row[c - c0]) for row in codes[after - 1:after + 1])
        return u + (v - u) * (time - ta) / (tb - ta)

    def scaled(self, g, h, c, difference):
        """A difference of codes of h in steps of g."""
        if self.shared.width[self.a][g] == self.shared.width[self.a][h]: return difference
        return difference * self.shared.quantizer(self.a, h, c)[0] / self.shared.quantizer(self.a, g, c)[0]

# --- A whole file ------------------------------------------------------------------------------------------------------

class Scene:
    """`info`: the fields of INFO; `tracks[a][g * C + c]`: times and codes."""
    def __init__(self, info, shared, tracks): self.info, self.shared, self.tracks = info, shared, tracks

    def at(self, t):
        """All attributes at a timestep, each a list of N C floats."""
        values = []
        for a in range(5):
            rows = [self.track_at(a, i, t) for i in range(len(self.tracks[a]))]
            if a == QUATS: rows = [x for i in range(0, len(rows), 4) for x in unit(rows[i:i + 4])]
            values.append(rows)
        return values

    def track_at(self, a, i, t):
        times, codes = self.tracks[a][i]
        value = lambda k: f32(self.shared.value(a, i // COMPONENTS[a], i % COMPONENTS[a], codes[k]))
        k = bisect.bisect_right(times, t) - 1
        v = value(k)
        if times[k] == t or k + 1 == len(times): return v
        along = f32((t - times[k]) / (times[k + 1] - times[k]))
        return f32(v + f32(f32(value(k + 1) - v) * along))

def unit(quat):
    def squares(values):
        total = 0.0
        for x in values: total = f32(total + f32(x * x))
        return total
    length = f32(math.sqrt(squares(quat)))
    if length > 0: quat = [f32(x / length) for x in quat]
    return quat if squares(quat) > 0.5 else [1.0, 0.0, 0.0, 0.0]

def decode(data, open_symbols=lambda place, body: Symbols(body, section_name(place[0]))):
    """The scene in the bytes of a file.

    - `open_symbols`: the reader of the symbols of a section at (tag, segment, layer); forge.py gives another
    """
    sections = iter(read_container(data))
    def section(*place):
        found = next(sections, None)
        must(found is not None and found[:3] == place, 'header', 'tag', 'not the section that is due')
        return found[3]
    info = read_info(Fields(section(b'INFO', SHARED, 0), 'info'))
    plan = read_plan(Fields(section(b'PLAN', SHARED, 0), 'plan'))
    N, T, L = info['num_gaussians'], info['num_timesteps'], info['segment_length']
    varying = [a for a in range(5) if plan['varies'][a]]
    if N == 0 or not varying: L = T
    num_segments = (T + L - 1) // L
    must(num_segments <= 65535, 'info', 'segment_length', 'more than 65535 segments')
    must(512 * N <= 2**24 + 1024 * len(data), 'limit', 'limit', 'more than this decoder takes')

    starts = [sum(info['layers'][:i]) for i in range(len(info['layers']) + 1)]
    layers = [range(*pair) for pair in zip(starts, starts[1:])]
    shared = Shared(plan)
    symbols = lambda *place: open_symbols(place, section(*place))
    for i, layer in enumerate(layers):
        shared.read_maps(symbols(b'MAPS', SHARED, i), layer)
        shared.read_positions(symbols(b'MEAN', SHARED, i), layer)
        shared.find_neighbors(layer)
        for a in range(1, 5): shared.read_first_codes(a, symbols(TAGS[a], SHARED, i), layer)
    joined = [{} for _ in range(5)]
    for s in range(num_segments):
        first, last = s * L, min((s + 1) * L, T) - 1
        attributes = {a: SegmentOf(a, shared, first, last, T) for a in varying}
        for i, layer in enumerate(layers):
            for a in varying:
                body = section(TAGS[a], s, i)
                must(len(body) > 0 and body[0] <= 3, NAMES[a], 'motion', 'unknown')
                attributes[a].read_layer(open_symbols((TAGS[a], s, i), body[1:]), layer, body[0])
        for a in varying: join(a, joined[a], attributes[a].units)
    must(next(sections, None) is None, 'header', 'tag', 'a section too many')

    tracks = []
    for a in range(5):
        of_attribute = []
        for g in range(N):
            for c in range(COMPONENTS[a]):
                c0 = 0 if plan['joint'][a] else c
                times, codes = joined[a].get((g, c0), ([0], None))
                codes = [shared.code[a][g][c]] if codes is None else [row[c - c0] for row in codes]
                of_attribute.append((times, codes))
        tracks.append(of_attribute)
    return Scene(info, shared, tracks)

def join(a, joined, units):
    """Adds the keypoints of a segment; those that it shares with the segments before must be the same."""
    for unit, (times, codes) in units.items():
        known_times, known_codes = joined.setdefault(unit, ([], []))
        known = bisect.bisect_left(known_times, times[0])
        shared = len(known_times) - known
        same = known_times[known:] == times[:shared] and known_codes[known:] == codes[:shared]
        must(same, NAMES[a], 'keypoints', 'segments disagree on one that they share')
        known_times += times[shared:]
        known_codes += codes[shared:]

# --- Command line ------------------------------------------------------------------------------------------------------

def floats(scene):
    """All floats of a scene, timestep by timestep, as bytes."""
    for t in range(scene.info['num_timesteps']):
        for values in scene.at(t): yield struct.pack(f'<{len(values)}f', *values)

def differences(scene, expected):
    """What differs from the values in a FILE.json."""
    for key in scene.info:
        found, want = scene.info[key], expected[key]
        if found != (f32(want) if key == 'frame_rate' else want): yield f'{key}: {found}, expected {want}'
    for a, name in enumerate(NAMES):
        want = expected['attributes'][name]
        if scene.shared.plan['varies'][a] != want['varies']: yield f'{name}: varies'
        if scene.shared.width[a] != want['widths']: yield f'{name}: widths'
        if [list(track) for track in scene.tracks[a]] != want['tracks_of_times_and_codes']: yield f'{name}: tracks'
    for at in expected['reconstructed']:
        for name, found in zip(NAMES, scene.at(at['timestep'])):
            want = [f32(float(x)) for x in at['values'][name]]
            if struct.pack(f'{len(found)}f', *found) != struct.pack(f'{len(want)}f', *want):
                yield f'{name} at timestep {at["timestep"]}: {found}, expected {want}'

def read(path):
    with open(path, 'rb') as file: return file.read()

def main(arguments):
    if arguments[:1] == ['--check'] and len(arguments) > 1:
        for path in arguments[1:]:
            expected = json.loads(read(path.removesuffix('.tcgs') + '.json'))
            for difference in differences(decode(read(path)), expected): sys.exit(f'{path}: {difference}')
            print(f'{path} is what it should be')
    elif len(arguments) == 2:
        try: scene = decode(read(arguments[0]))
        except Refused as refused: sys.exit(f'{arguments[0]}: {refused}')
        with open(arguments[1], 'wb') as out: out.writelines(floats(scene))
    else: sys.exit(__doc__)

if __name__ == '__main__': main(sys.argv[1:])
