"""A decoder of .tcgs versions 1 and 2, written from docs/FORMAT.md; it shares no code with the Rust one. Slow and complete: it
checks the text, and it is the reference of scripts/conformance.py.

Usage:
  decode.py FILE.tcgs OUT             write all floats of a file, as docs/FORMAT.md says under "Conformance"
  decode.py --check FILE.tcgs...      compare each file with the values that it means, in the FILE.json beside it
"""
import bisect, json, math, struct, sys, zlib

# Attributes that every Gaussian has. Those of a cohort are in its plan.
NAMES = ['means', 'quats', 'log_scales', 'logit_opacities', 'colors']
COMPONENTS = [3, 4, 3, 1, 3]
ACTIVATIONS = [0, 1, 2, 3, 0]
TAGS = [b'MEAN', b'QUAT', b'SCAL', b'OPAC', b'COLR']
BASE = len(NAMES)
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

# --- Container
# ---------------------------------------------------------------------------------------------------------

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
    def flags(self, field, count):
        byte = self.u(1, field)
        must(byte >> count == 0, self.section, field, 'unknown')
        return [byte >> i & 1 == 1 for i in range(count)]
    def end(self): must(self.at == len(self.data), self.section, 'end', 'bytes are left over')

def section_name(tag):
    known = {b'INFO': 'info', b'COHO': 'cohorts', b'appl': 'application data'}
    known |= {b'PLAN': 'plan', b'MAPS': 'maps'} | dict(zip(TAGS, NAMES))
    return known.get(tag, 'unknown section')

def name_in_errors(name): return 'skipped attribute' if name is None else name if name == 'maps' or name in NAMES else 'further attribute'

def version_of(data):
    must(data[:4] == b'TCGS'[:len(data)], 'header', 'magic', 'this is not a .tcgs file')
    must(len(data) >= 16, 'file', 'end', 'the file ends early')
    version = int.from_bytes(data[4:6], 'little')
    must(version in (1, 2), 'version', 'version', 'another version')
    return version

class Cohort:
    """What is known of a cohort before its symbols. All Gaussians of a file of version 1 are one.

    - `segment_length`: as in the file; `span` has the one in effect
    - `shared[layer]`: bytes of the maps and of every attribute; `segments[s][layer]`: of every attribute that varies
    """
    def __init__(self, plan, start, num_timesteps, num_gaussians, layers, segment_length, has_lives, section):
        must(sum(layers) == num_gaussians, section, 'layers', 'not as many Gaussians as the scene')
        must(0 not in layers, section, 'layers', 'an empty one')
        must(1 <= segment_length <= 65536, section, 'segment_length', 'not within 1 to 65536')
        self.plan, self.start, self.num_timesteps, self.has_lives = plan, start, num_timesteps, has_lives
        self.num_gaussians, self.segment_length = num_gaussians, segment_length
        self.varying = [a for a, varies in enumerate(plan['varies']) if varies]
        moves = num_gaussians > 0 and any(varies for _, varies in plan['listed'])
        self.length = segment_length if moves else num_timesteps
        self.num_segments = (num_timesteps + self.length - 1) // self.length
        must(self.num_segments <= 65535, section, 'segment_length', 'more than 65535 segments')
        starts = [sum(layers[:i]) for i in range(len(layers) + 1)]
        self.layers = [range(*pair) for pair in zip(starts, starts[1:])]
        self.shared, self.segments = [], []
    def span(self, s):
        """First and last timestep of a segment, counted from the start of the cohort."""
        return s * self.length, min((s + 1) * self.length, self.num_timesteps) - 1
    def names_in_segments(self): return [name for name, varies in self.plan['listed'] if varies]

def read_scene(f):
    """The fields of INFO that both versions have."""
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
    return s | {'name': f.text('name'), 'generator': f.text('generator')}

def check_scene(f, s):
    must(s['num_timesteps'] >= 1, 'info', 'num_timesteps', 'zero')
    must(math.isfinite(s['frame_rate']) and s['frame_rate'] >= 0, 'info', 'frame_rate', 'negative or not finite')
    must(s['downscale'] >= 1, 'info', 'downscale', 'zero')
    f.end()
    return s

def read_layers(f): return [f.u(4, 'layers') for _ in range(f.u(2, 'number of layers'))]

def new_plan():
    """`listed`: name of every attribute, None of one that is skipped, and whether it varies. `skipped`: what else cohorts
    must agree in. All else is of those that are not skipped."""
    keys = 'names units components activations varies joint lacking quantizers predictors listed skipped'
    return {key: [] for key in keys.split()}

def read_attribute(f, plan, a):
    """What both versions say of an attribute: quantizers and predictors."""
    must(f.u(1, 'interpolation') == 0, f.section, 'interpolation', 'unknown')
    quantizers, predictors, components = {}, [], plan['components'][a]
    for _ in range(f.u(1, 'number of widths')):
        b = f.u(1, 'width')
        must(b > max(quantizers, default=-1), f.section, 'width', 'not ascending')
        quantizers[b] = []
        for _ in range(components):
            step, offset = f.f('step'), f.f('offset')
            legal = 1 <= b <= 16 and 0 < step < math.inf and math.isfinite(offset)
            must(legal, f.section, 'quantizer', 'not 1 to 16 bits, or not finite, or a step that is not positive')
            quantizers[b].append((step, offset))
    for c in range(components if a != MEANS else 0):
        mode = f.u(1, 'mode')
        must(mode <= 2, f.section, 'mode', 'unknown')
        weights = [f.f('weight') for _ in range(1 + 2 * components + c if a < BASE else 3 + min(c, 3))]
        must(all(map(math.isfinite, weights)), f.section, 'weight', 'not finite')
        predictors.append((mode, weights))
    plan['quantizers'].append(quantizers)
    plan['predictors'].append(predictors)

# --- Container of version 1
# ----------------------------------------------------------------------------------------------

def open_1(data):
    """Fields of INFO, and the only cohort."""
    top = Fields(data, 'header')
    top.take(6, 'magic')
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
        must(optional or tag in (b'INFO', b'PLAN', b'MAPS', *TAGS), 'header', 'tag', 'may not be skipped')
        entries.append((tag, segment, layer, data[at:at + length], crc, optional))
        at += length
    must(at <= len(data), 'file', 'end', 'the file ends early')
    must(at == len(data), 'file', 'end', 'bytes are left over')
    for tag, _, _, body, crc, _ in entries:
        must(zlib.crc32(body) == crc, section_name(tag), 'checksum', 'the section is damaged')
    sections = iter([entry[:4] for entry in entries if not entry[5]])
    def section(*place):
        found = next(sections, None)
        must(found is not None and found[:3] == place, 'header', 'tag', 'not the section that is due')
        return found[3]

    info = read_info_1(Fields(section(b'INFO', SHARED, 0), 'info'))
    plan = read_plan_1(Fields(section(b'PLAN', SHARED, 0), 'plan'))
    T, N = info['num_timesteps'], info['num_gaussians']
    cohort = Cohort(plan, 0, T, N, info['layers'], info['segment_length'], False, 'info')
    for i in range(len(cohort.layers)):
        cohort.shared.append([section(tag, SHARED, i) for tag in [b'MAPS'] + TAGS])
    for s in range(cohort.num_segments):
        of_layer = lambda i: [section(TAGS[a], s, i) for a in cohort.varying]
        cohort.segments.append([of_layer(i) for i in range(len(cohort.layers))])
    must(next(sections, None) is None, 'header', 'tag', 'a section too many')
    return info, [cohort]

def read_info_1(f):
    s = read_scene(f)
    return check_scene(f, s | {'segment_length': f.u(4, 'segment_length'), 'layers': read_layers(f)})

def read_plan_1(f):
    plan = new_plan() | {'names': NAMES, 'components': COMPONENTS, 'activations': ACTIVATIONS}
    plan |= {'units': [''] * BASE, 'lacking': [False] * BASE}
    plan['varies'], plan['joint'] = f.flags('varying attributes', BASE), f.flags('joint attributes', BASE)
    for a in range(BASE): read_attribute(f, plan, a)
    plan['listed'] = list(zip(NAMES, plan['varies']))
    f.end()
    return plan

# --- Container of version 2
# ----------------------------------------------------------------------------------------------

def open_2(data):
    """Fields of INFO, and all cohorts."""
    top = Fields(data, 'header')
    top.take(6, 'magic')
    count = top.u(2, 'number of sections')
    end = 20 + 24 * count
    must(len(data) >= end, 'file', 'end', 'the file ends early')
    length = top.u(8, 'length of the file')
    must(top.u(4, 'checksum') == zlib.crc32(data[:16] + data[20:end]), 'header', 'checksum', 'the header is damaged')
    parts, entries = [(0, end)], []
    for _ in range(count):
        tag, crc, offset, size = top.take(4, 'tag'), top.u(4, 'checksum'), top.u(8, 'offset'), top.u(8, 'length')
        must(parts[-1][1] <= offset and offset + size <= length, 'header', 'offset', 'not in order, or beyond the end')
        optional = tag[0] & 0x20 != 0
        must(optional or tag in (b'INFO', b'COHO'), 'header', 'tag', 'may not be skipped')
        parts.append((offset, offset + size))
        entries.append((tag, data[offset:offset + size], crc, offset + size, optional))
    needed = [entry for entry in entries if not entry[4]]
    must([entry[0] for entry in needed] == [b'INFO', b'COHO'], 'header', 'tag', 'not the sections that are due')
    def opened(tag, body, crc, _, __):
        must(zlib.crc32(body) == crc, section_name(tag), 'checksum', 'the section is damaged')
        return Fields(body, section_name(tag))
    end = needed[1][3]
    must(end <= len(data), 'file', 'end', 'the file ends early')
    info = read_info_2(opened(*needed[0]))
    places = read_cohorts(opened(*needed[1]), info, end, length)
    must(length <= len(data), 'file', 'end', 'the file ends early')
    must(length == len(data), 'file', 'end', 'bytes are left over')
    for entry in entries: opened(*entry)

    cohorts, pieces = [], []
    for place in places:
        plan = cohorts[place['plan']].plan if place['plan'] < len(cohorts) else None
        cohort, of_cohort = read_head(data, place, plan, length, cohorts)
        pieces += [(cohort.start + t, len(cohorts), i, part) for i, (t, part) in enumerate(of_cohort)]
        cohorts.append(cohort)
    for before, cohort in zip(cohorts, cohorts[1:]):
        same = described(before.plan) == described(cohort.plan)
        must(same, 'cohort', 'attributes', 'others than those of the first cohort')
    # Parts cover the file, and pieces come in the order in which they are needed.
    pieces = [piece[3] for piece in sorted(pieces)]
    ordered = all(a[0] <= b[0] for a, b in zip(pieces, pieces[1:]))
    must(ordered, 'file', 'end', 'parts come in another order than that in which they are needed')
    parts = sorted(parts + pieces) + [(length, length)]
    covered = all(a[1] == b[0] for a, b in zip(parts, parts[1:]))
    must(covered, 'file', 'end', 'parts leave a gap or overlap')
    return info, cohorts

def read_info_2(f):
    s = read_scene(f) | {'errors': []}
    for _ in range(f.u(1, 'number of errors')):
        name, error = f.text('name of an attribute'), f.f('error')
        must(math.isfinite(error) and error >= 0, 'info', 'error', 'negative or not finite')
        s['errors'].append([name, error])
    return check_scene(f, s)

def read_cohorts(f, info, end, length):
    """The section COHO.

    - `end`: where it ends in the file
    - `length`: of the file
    """
    count = f.u(4, 'number of cohorts')
    must(count <= 2**20, 'cohorts', 'number of cohorts', 'more than 1048576')
    places, start = [], 0
    fields = 'start num_timesteps num_gaussians plan head_bytes head_checksum shared_bytes'.split()
    for index in range(count):
        p = {field: f.u(4, field) for field in fields} | {'offset': f.u(8, 'offset')}
        must(p['start'] >= start, 'cohorts', 'start', 'not ascending')
        within = 1 <= p['num_timesteps'] <= 65536 and p['start'] + p['num_timesteps'] <= info['num_timesteps']
        must(within, 'cohorts', 'num_timesteps', 'not within 1 to 65536, or beyond the end of the scene')
        must(p['num_gaussians'] > 0, 'cohorts', 'num_gaussians', 'none')
        own = p['plan'] == index or p['plan'] < index and places[p['plan']]['plan'] == p['plan']
        must(own, 'cohorts', 'plan', 'that of a cohort without one of its own')
        after = p['offset'] + p['head_bytes'] + p['shared_bytes']
        must(end <= p['offset'] and after <= length, 'cohorts', 'offset', 'not in order, or beyond the end')
        start, end = p['start'], after
        places.append(p)
    total = sum(p['num_gaussians'] for p in places)
    must(total == info['num_gaussians'], 'cohorts', 'num_gaussians', 'not as many Gaussians as the scene')
    f.end()
    return places

def read_head(data, place, plan, length, known):
    """A cohort, and its pieces: the first timestep at which each is needed, and its first byte and that after its last.

    - `plan`: the one that it shares with a cohort before
    - `known`: any cohort before
    - `length`: of the file
    """
    at = place['offset']
    end = at + place['head_bytes']
    must(zlib.crc32(data[at:end]) == place['head_checksum'], 'cohort', 'checksum', 'the head is damaged')
    f = Fields(data[at:end], 'cohort')
    has_lives, antialiased = f.flags('flags', 2)
    must(not known or known[0].antialiased == antialiased, 'cohort', 'flags', 'antialiased, unlike another cohort')
    segment_length, layers = f.u(4, 'segment_length'), read_layers(f)
    plan = plan or read_plan_2(f)
    cohort = Cohort(plan, place['start'], place['num_timesteps'], place['num_gaussians'], layers, segment_length, has_lives, 'cohort')
    cohort.antialiased = antialiased
    in_segments = cohort.names_in_segments()
    segments = range(cohort.num_segments if in_segments else 0)
    count = len(layers) * (1 + len(plan['listed']) + len(segments) * len(in_segments)) + len(segments)
    must(len(f.data) - f.at == 8 * count, 'cohort', 'sections', 'not as many as layers, segments and attributes make')
    def section(name):
        nonlocal end
        start, end = end, end + f.u(4, 'length')
        return name, data[start:end], f.u(4, 'checksum')
    # Checksums of sections are for those who read them; nobody reads what is skipped.
    def sections(names):
        found = [section(name) for name in names]
        return [s for s in found if s[0] is not None or checked(s) is None]
    cohort.shared = [sections(['maps'] + [name for name, _ in plan['listed']]) for _ in layers]
    wanted = place['offset'] + place['head_bytes'] + place['shared_bytes']
    must(end == wanted, 'cohort', 'length', 'not as many bytes of shared layers as the table of cohorts says')
    pieces = [(0, (at, end))]
    for s in segments:
        start = f.u(8, 'offset of a segment')
        must(start >= end, 'cohort', 'offset of a segment', 'not after the one before')
        end = start
        cohort.segments.append([sections(in_segments) for _ in layers])
        pieces.append((cohort.span(s)[0], (start, end)))
    must(end <= length, 'cohort', 'offset of a segment', 'beyond the end of the file')
    f.end()
    return cohort, pieces

def read_plan_2(f):
    plan = new_plan()
    count = f.u(1, 'number of attributes')
    for place in range(count):
        a = len(plan['names'])
        name, unit = f.text('name of an attribute'), f.text('unit')
        known = [n for n, _ in plan['listed']] + [n for _, n, *_ in plan['skipped']]
        must(a < BASE or name not in known, 'cohort', 'name of an attribute', 'that of another attribute')
        components, activation, flags = f.u(1, 'components'), f.u(1, 'activation'), f.u(1, 'flags of an attribute')
        varies, joint, lacking, optional = (flags >> i & 1 == 1 for i in range(4))
        if flags >> 4 != 0:
            must(optional and place >= BASE, 'cohort', 'coding of an attribute', 'unknown')
            f.take(f.u(4, 'length of an attribute'), 'length of an attribute')
            plan['skipped'].append((place, name, unit, components, activation, flags >> 4))
            plan['listed'].append((None, varies))
            continue
        must(activation <= 3, 'cohort', 'activation', 'unknown')
        if a < BASE:
            due = (NAMES[a], COMPONENTS[a], ACTIVATIONS[a])
            must((name, components, activation) == due, 'cohort', 'name of an attribute', 'not the attribute that is due')
            must(not lacking and not optional, 'cohort', 'flags of an attribute', 'one that every Gaussian has may be lacking')
        else:
            must(1 <= components <= 32, 'cohort', 'components', 'not within 1 to 32')
        values = name, unit, components, activation, varies, joint, lacking
        for key, value in zip('names units components activations varies joint lacking'.split(), values): plan[key].append(value)
        plan['listed'].append((name, varies))
        read_attribute(f, plan, a)
    must(count >= BASE, 'cohort', 'number of attributes', 'fewer than every Gaussian has')
    return plan

def described(plan):
    """What all cohorts have in common."""
    return plan['names'], plan['components'], plan['activations'], plan['units'][BASE:], plan['skipped']

# --- Symbols
# -----------------------------------------------------------------------------------------------------------

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

# --- Shared layers
# -----------------------------------------------------------------------------------------------------

def curve_key(point, bits):
    return sum((point[c] >> j & 1) << (3 * j + c) for j in range(bits) for c in range(3))

class Shared:
    """What all segments share: lives, widths, which tracks move, first codes, neighbours."""
    def __init__(self, plan, num_timesteps, has_lives):
        self.plan, self.components, self.attributes = plan, plan['components'], range(len(plan['components']))
        self.last, self.has_lives = num_timesteps - 1, has_lives
        self.width, self.moves, self.code = ([[] for _ in self.attributes] for _ in range(3))
        self.lives, self.neighbors, self.points, self.curve = [], [], [], []
        self.births, self.left = Numbers('birth'), Numbers('left')
        self.maps = Models(16, 'width'), Models(2, 'moves'), Models(2, 'present')
        self.curve_models = Models(13, 'gap high'), Models(4, 'gap low'), Models(8, 'gap leading')
        self.gap_before = 0
        self.first = [(Models(16, 'high'), Models(16, 'middle'), Numbers('difference')) for _ in self.attributes]

    def quantizer(self, a, g, c): return self.plan['quantizers'][a][self.width[a][g]][c]
    def value(self, a, g, c, code):
        if self.width[a][g] == 0: return 0.0
        step, offset = self.quantizer(a, g, c)
        return code * step + offset

    def read_maps(self, symbols, layer):
        widths, moving, present = self.maps
        for g in layer:
            self.lives.append(self.read_life(symbols) if self.has_lives else (0, self.last))
            there = 0
            for a in self.attributes:
                before = self.width[a][g - 1] if g > 0 else 0
                left = self.width[a - 1][g] if a > 1 else 0
                if self.plan['lacking'][a]: there = symbols.read(present[a, before > 0, there]) % 2
                has = there or not self.plan['lacking'][a]
                self.width[a].append(1 + symbols.read(widths[a, before, left]) if has else 0)
            decision = 0
            for a in self.attributes:
                row = [0] * self.components[a]
                for c in range(self.components[a] if self.plan['varies'][a] and self.width[a][g] > 0 else 0):
                    if self.plan['joint'][a] and c > 0:
                        row[c] = row[0]
                        continue
                    one, two = (self.moves[a][g - k][c] if g >= k else 0 for k in (1, 2))
                    decision = row[c] = symbols.read(moving[a, c, one, two, decision]) % 2
                self.moves[a].append(row)
        symbols.end()
        for a in self.attributes:
            known = all(self.width[a][g] in (0, *self.plan['quantizers'][a]) for g in layer)
            must(known, 'maps', 'bit widths', 'a width without quantizers')

    def read_life(self, symbols):
        birth = self.births.read(symbols, 0)
        left = self.left.read(symbols, birth > 0)
        must(birth + left <= self.last, 'maps', 'lives', 'not within the timesteps of the cohort')
        return birth, self.last - left

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
        count = self.components[a]
        for g in layer:
            b, codes = self.width[a][g], []
            self.code[a].append(codes)
            if b == 0:
                codes += [0] * count
                continue
            two = (self.neighbors[g] * 2)[:2]
            near = [[self.value(a, h, c, self.code[a][h][c]) for c in range(count)] for h in two]
            near = near or [[0.0] * count] * 2
            before, rest = [], 1.0
            for c in range(count):
                features = [1.0] + near[0] + near[1] + before
                if a >= BASE: features = [1.0, near[0][c], near[1][c]] + before[-3:]
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
                before.append(value)
        symbols.end()

# --- Segments
# ----------------------------------------------------------------------------------------------------------

class SegmentOf:
    """The keypoints of one attribute within one segment: (times, codes[keypoint][component]) by Gaussian and unit."""
    def __init__(self, a, shared, first, last):
        self.a, self.shared, self.first, self.last = a, shared, first, last
        self.components = shared.components[a]
        self.per = self.components if shared.plan['joint'][a] else 1
        self.units = {}
        self.counts = Models(16, 'count')
        names = 'more', 'before', 'after', 'gap', 'first', 'later'
        self.more, self.before, self.after, self.gaps, self.firsts, self.laters = map(Numbers, names)

    def read_layer(self, symbols, layer, motion):
        inner_before = 0
        for g in layer:
            B, D = self.shared.lives[g]
            if B > self.last or D < self.first: continue
            for c0 in range(0, self.components, self.per):
                if self.shared.moves[self.a][g][c0]:
                    inner_before = self.read_unit(symbols, motion, g, range(c0, c0 + self.per), inner_before)
        symbols.end()

    def read_unit(self, symbols, motion, g, components, inner_before):
        a, c0, (B, D) = self.a, components[0], self.shared.lives[g]
        A, Z = max(self.first, B), min(self.last, D)
        late = lambda holds: must(holds, name_in_errors(self.shared.plan['names'][a]), 'keypoint times', 'not within the timesteps that are left')
        # Those that move and live in this segment.
        neighbor = next((h for h in self.shared.neighbors[g] if (h, c0) in self.units), NONE)
        b = self.shared.width[a][g]
        before = self.before.read(symbols, 0) if A > B else 0
        late(before <= A - B)
        times, codes = [A - before], [self.read_start(symbols, g, components, neighbor, A - before, A == B)]
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
        times.append(Z + (self.after.read(symbols, 0) if Z < D else 0))
        late(times[-1] <= D)
        if k == 0: codes.append(codes[0])
        else: self.read_later(symbols, motion, g, components, neighbor)
        return inner

    def read_start(self, symbols, g, components, neighbor, time, is_born):
        a, codes, last_size = self.a, [], 0
        for c in components:
            code, b = self.shared.code[a][g][c], self.shared.width[a][g]
            if not is_born:
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

# --- A whole file
# ------------------------------------------------------------------------------------------------------

class Decoded:
    """A decoded cohort. `tracks[a][g * C + c]`: times, counted from the start of the cohort, and codes."""
    def __init__(self, head, shared, tracks): self.head, self.shared, self.tracks = head, shared, tracks

    def at(self, t):
        """All attributes of the Gaussians that live at a timestep of the scene, a list of floats each."""
        now = t - self.head.start
        if not 0 <= now < self.head.num_timesteps: return [[] for _ in self.tracks]
        living = [g for g, (B, D) in enumerate(self.shared.lives) if B <= now <= D]
        values = []
        for a, count in enumerate(self.shared.components):
            rows = [[self.track_at(a, g * count + c, now) for c in range(count)] for g in living]
            if a == QUATS: rows = [unit(row) for row in rows]
            values.append([x for row in rows for x in row])
        return values

    def track_at(self, a, i, t):
        times, codes = self.tracks[a][i]
        g, c = divmod(i, self.shared.components[a])
        value = lambda k: f32(self.shared.value(a, g, c, codes[k]))
        k = bisect.bisect_right(times, t) - 1
        v = value(k)
        if times[k] == t or k + 1 == len(times): return v
        along = f32((t - times[k]) / (times[k + 1] - times[k]))
        return f32(v + f32(f32(value(k + 1) - v) * along))

class Scene:
    """`info`: the fields of INFO; `cohorts`: decoded."""
    def __init__(self, info, cohorts): self.info, self.cohorts = info, cohorts
    def names(self): return self.cohorts[0].head.plan['names'] if self.cohorts else NAMES
    def components(self): return self.cohorts[0].shared.components if self.cohorts else COMPONENTS
    def at(self, t):
        """All attributes of the Gaussians that live at a timestep, cohort by cohort, a list of floats each."""
        parts = [cohort.at(t) for cohort in self.cohorts]
        return [[x for part in parts for x in part[a]] for a in range(len(self.names()))]

def unit(quat):
    def squares(values):
        total = 0.0
        for x in values: total = f32(total + f32(x * x))
        return total
    length = f32(math.sqrt(squares(quat)))
    if length > 0: quat = [f32(x / length) for x in quat]
    return quat if squares(quat) > 0.5 else [1.0, 0.0, 0.0, 0.0]

def decode(data, open_symbols=lambda place, body: Symbols(body, name_in_errors(place[0]))):
    """The scene in the bytes of a file.

    - `open_symbols`: the reader of the symbols of a section at (`maps` or the name of an attribute, segment, layer,
      cohort); forge.py gives another
    """
    info, cohorts = (open_1 if version_of(data) == 1 else open_2)(data)
    memory = sum(cohort.num_gaussians * (512 + 32 * sum(cohort.plan['components'][BASE:])) for cohort in cohorts)
    must(memory <= 2**24 + 1024 * len(data), 'limit', 'limit', 'more than this decoder takes')
    return Scene(info, [decode_cohort(i, cohort, open_symbols) for i, cohort in enumerate(cohorts)])

def decode_cohort(index, head, open_symbols):
    plan, attributes = head.plan, range(len(head.plan['names']))
    shared = Shared(plan, head.num_timesteps, head.has_lives)
    for i, layer in enumerate(head.layers):
        bodies = [checked(body) for body in head.shared[i]]
        symbols = lambda name, body: open_symbols((name, SHARED, i, index), body)
        shared.read_maps(symbols('maps', bodies[0]), layer)
        shared.read_positions(symbols('means', bodies[1]), layer)
        shared.find_neighbors(layer)
        for a in attributes[1:]: shared.read_first_codes(a, symbols(plan['names'][a], bodies[1 + a]), layer)
    joined = [{} for _ in attributes]
    for s, of_segment in enumerate(head.segments):
        readers = [SegmentOf(a, shared, *head.span(s)) for a in head.varying]
        for i, layer in enumerate(head.layers):
            for reader, body in zip(readers, of_segment[i]):
                name, body = plan['names'][reader.a], checked(body)
                must(len(body) > 0 and body[0] <= 3, name_in_errors(name), 'motion', 'unknown')
                reader.read_layer(open_symbols((name, s, i, index), body[1:]), layer, body[0])
        for reader in readers: join(plan['names'][reader.a], joined[reader.a], reader.units)

    tracks = []
    for a in attributes:
        of_attribute = []
        for g in range(head.num_gaussians):
            for c in range(plan['components'][a]):
                c0 = 0 if plan['joint'][a] else c
                times, codes = joined[a].get((g, c0), ([0], None))
                codes = [shared.code[a][g][c]] if codes is None else [row[c - c0] for row in codes]
                # A track that moves in a life of one timestep.
                of_attribute.append((times if len(times) > 1 else [0], codes))
        tracks.append(of_attribute)
    return Decoded(head, shared, tracks)

def checked(section):
    """The bytes of a section; those of version 1 were checked before."""
    if isinstance(section, bytes): return section
    name, body, crc = section
    must(zlib.crc32(body) == crc, name_in_errors(name), 'checksum', 'the section is damaged')
    return body

def join(name, joined, units):
    """Adds the keypoints of a segment; those that it shares with the segments before must be the same."""
    for unit, (times, codes) in units.items():
        known_times, known_codes = joined.setdefault(unit, ([], []))
        known = bisect.bisect_left(known_times, times[0])
        shared = len(known_times) - known
        same = known_times[known:] == times[:shared] and known_codes[known:] == codes[:shared]
        must(same, name_in_errors(name), 'keypoints', 'segments disagree on one that they share')
        known_times += times[shared:]
        known_codes += codes[shared:]

# --- Command line
# ------------------------------------------------------------------------------------------------------

def floats(scene):
    """All floats of a scene, timestep by timestep, as bytes."""
    for t in range(scene.info['num_timesteps']):
        for values in scene.at(t): yield struct.pack(f'<{len(values)}f', *values)

def differences(scene, expected):
    """What differs from the values in a FILE.json."""
    for key, found in scene.info.items():
        want = expected[key]
        if key == 'frame_rate': want = f32(want)
        if key == 'errors': want = [[name, f32(error)] for name, error in want]
        if found != want: yield f'{key}: {found}, expected {want}'
    # Of version 1 the only cohort is the file.
    cohorts = expected.get('cohorts', [expected])
    if len(scene.cohorts) != len(cohorts): yield f'{len(scene.cohorts)} cohorts, expected {len(cohorts)}'
    for i, (cohort, want) in enumerate(zip(scene.cohorts, cohorts)):
        for difference in cohort_differences(cohort, want): yield f'cohort {i}: {difference}'
    for at in expected['reconstructed']:
        for name, found in zip(scene.names(), scene.at(at['timestep'])):
            want = [f32(float(x)) for x in at['values'][name]]
            if struct.pack(f'{len(found)}f', *found) != struct.pack(f'{len(want)}f', *want):
                yield f'{name} at timestep {at["timestep"]}: {found}, expected {want}'

def cohort_differences(cohort, expected):
    head, shared, plan = cohort.head, cohort.shared, cohort.head.plan
    found = {'start': head.start, 'num_timesteps': head.num_timesteps, 'num_gaussians': head.num_gaussians}
    found |= {'segment_length': head.segment_length, 'layers': [len(layer) for layer in head.layers]}
    if expected.get('antialiased', False) != getattr(head, 'antialiased', False): yield 'antialiased'
    found['lives'] = [list(life) for life in shared.lives] if head.has_lives else None
    for key in found:
        if key in expected and found[key] != expected[key]: yield f'{key}: {found[key]}, expected {expected[key]}'
    if plan['names'] != expected.get('names', NAMES): yield f'names: {plan["names"]}'
    for a, name in enumerate(plan['names']):
        want = expected['attributes'][name]
        tracks = [list(track) for track in cohort.tracks[a]]
        found = {'unit': plan['units'][a], 'components': plan['components'][a], 'activation': plan['activations'][a]}
        found |= {'varies': plan['varies'][a], 'widths': shared.width[a], 'tracks_of_times_and_codes': tracks}
        for key in found:
            if key in want and found[key] != want[key]: yield f'{name}: {key}'

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
