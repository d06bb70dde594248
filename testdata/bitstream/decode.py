"""A decoder of .tcgs version 1 written from docs/FORMAT.md alone. Slow, complete, of no use but to check the text.

Usage: decode.py FILE.tcgs...: compares each with the values that it means, in the FILE.json beside it.
"""
import json, math, struct, sys, zlib
f32 = lambda x: struct.unpack('<f', struct.pack('<f', x))[0]
NAMES = ['means', 'quats', 'log_scales', 'logit_opacities', 'colors']
TAGS = [b'MEAN', b'QUAT', b'SCAL', b'OPAC', b'COLR']
C = [3, 4, 3, 1, 3]
log2 = lambda n: n.bit_length() - 1
nearest = lambda x: math.floor(x + 0.5)
def wrap(x, b):
    return (x + 2**(b - 1)) % 2**b - 2**(b - 1)

class Fields:
    def __init__(self, data): self.data, self.at = data, 0
    def take(self, n):
        assert self.at + n <= len(self.data); self.at += n
        return self.data[self.at - n:self.at]
    def u(self, n): return int.from_bytes(self.take(n), 'little')
    def f(self): return struct.unpack('<f', self.take(4))[0]
    def text(self): return self.take(self.u(2)).decode('utf-8')
    def end(self): assert self.at == len(self.data)

class Model:
    def __init__(self, n):
        each = (2**30 - (16 - n) * 65536) // n
        self.f = [i * each if i < n else 2**30 - (16 - i) * 65536 for i in range(16)]
        self.age = 1
class Models(dict):
    def __init__(self, n): self.n = n
    def __missing__(self, key):
        n = self.n(key) if callable(self.n) else self.n
        self[key] = Model(n); return self[key]

class Symbols:
    def __init__(self, data):
        self.data = data; self.x = int.from_bytes(data[:8], 'little'); self.at = 8
        assert 2**31 <= self.x < 2**63
    def step(self, a, f):
        self.x = f * (self.x >> 15) + self.x % 2**15 - a
        if self.x < 2**31:
            assert self.at + 4 <= len(self.data)
            self.x = self.x * 2**32 + int.from_bytes(self.data[self.at:self.at + 4], 'little'); self.at += 4
    def read(self, m):
        y = self.x % 2**15
        starts = [v >> 15 for v in m.f] + [2**15]
        s = max(i for i in range(16) if starts[i] <= y)
        self.step(starts[s], starts[s + 1] - starts[s])
        m.age += 1; r = min(log2(m.age), 7)
        for i in range(1, 16):
            g = 65536 * i if i <= s else 2**30 - (16 - i) * 65536
            m.f[i] += (g - m.f[i]) >> r
        return s
    def bits(self, k):
        if k == 0: return 0
        v = (self.x % 2**15) >> (15 - k)
        self.step(v << (15 - k), 1 << (15 - k)); return v
    def end(self): assert self.x == 2**31 and self.at == len(self.data)

class Numbers:
    def __init__(self):
        self.symbol, self.exponent, self.leading = Models(16), Model(10), Models(lambda k: 2**min(k, 3))
    def read(self, s, context):
        u = s.read(self.symbol[context])
        if u < 8: return u
        if u < 14:
            e = u // 2 - 1; base = (2 + u % 2) * 2**(e - 1); k = e - 1
        else:
            e = 6 + min(s.read(self.exponent), 9); base = 2**e; k = e
        h = s.read(self.leading[k]) % 2**min(k, 3)
        return base + h * 2**(k - min(k, 3)) + s.bits(k - min(k, 3))
signed = lambda z: z // 2 if z % 2 == 0 else -(z + 1) // 2
size = lambda z: min(log2(z + 1), 5)
bucket = lambda i: 0 if i == 0 else min(log2(i + 1) + 1, 5)

def decode(data):
    top = Fields(data)
    assert top.take(4) == b'TCGS' and top.u(2) == 1 and top.u(2) == 0
    count = top.u(4); crc = top.u(4)
    assert crc == zlib.crc32(data[:12] + data[16:16 + 16 * count])
    sections, at = [], 16 + 16 * count
    for _ in range(count):
        tag, segment, layer, length, crc = top.take(4), top.u(2), top.u(2), top.u(4), top.u(4)
        body = data[at:at + length]; at += length
        assert len(body) == length and zlib.crc32(body) == crc
        if not tag[0] & 0x20: sections.append((tag, segment, layer, body))
    assert at == len(data)
    sections = iter(sections)
    def section(tag, segment, layer):
        t = next(sections); assert t[:3] == (tag, segment, layer), t[:3]
        return t[3]
    i = Fields(section(b'INFO', 65535, 0))
    s = {'num_gaussians': i.u(4), 'num_timesteps': i.u(4), 'first_frame': i.u(4), 'downscale': i.u(4), 'frame_rate': i.f()}
    bounds = [i.f() for _ in range(6)]
    s |= {'color_space': i.u(1), 'up': i.u(1), 'name': i.text(), 'generator': i.text(), 'segment_length': i.u(4)}
    s['layers'] = [i.u(4) for _ in range(i.u(2))]; i.end()
    N, T, L = s['num_gaussians'], s['num_timesteps'], s['segment_length']
    p = Fields(section(b'PLAN', 65535, 0))
    varies, joint = p.u(1), p.u(1)
    varies = [varies >> a & 1 for a in range(5)]; joint = [joint >> a & 1 for a in range(5)]
    quantizers, predictors = [], []
    for a in range(5):
        assert p.u(1) == 0
        q = {}
        for _ in range(p.u(1)):
            b = p.u(1); q[b] = [(p.f(), p.f()) for _ in range(C[a])]
        quantizers.append(q)
        predictors.append([(p.u(1), [p.f() for _ in range(1 + 2 * C[a] + c)]) for c in range(C[a])] if a else [])
    p.end()
    width = [[] for _ in range(5)]; moves = [[] for _ in range(5)]; code = [[] for _ in range(5)]
    value = lambda a, g, c, k: k * quantizers[a][width[a][g]][c][0] + quantizers[a][width[a][g]][c][1]
    wm, mm, hm, lm, dm = Models(16), Models(2), Models(13), Models(4), Models(8)
    firsts = [(Models(16), Models(16), Numbers()) for _ in range(5)]
    neighbors, points, curve, e_before = [], [], [], 0
    W = max(quantizers[0], default=16)
    key_of = lambda x, n: sum((x[c] >> j & 1) << (3 * j + c) for j in range(n) for c in range(3))
    start = 0
    for layer, n in enumerate(s['layers']):
        y = Symbols(section(b'MAPS', 65535, layer))
        for g in range(start, start + n):
            for a in range(5):
                before = width[a][g - 1] if g else 0
                other = 0 if a < 2 else width[a - 1][g]
                width[a].append(1 + y.read(wm[a, before, other]))
                assert width[a][g] in quantizers[a]
            o = 0
            for a in range(5):
                row = [0] * C[a]
                if varies[a]:
                    for c in range(C[a]):
                        if joint[a] and c: row[c] = row[0]; continue
                        was = lambda k: moves[a][g - k][c] if g >= k else 0
                        o = row[c] = y.read(mm[a, c, was(1), was(2), o]) % 2
                moves[a].append(row)
        y.end()
        y = Symbols(section(b'MEAN', 65535, layer)); key = 0
        for g in range(start, start + n):
            high = min(y.read(hm[e_before // 4]), 12); low = y.read(lm[high]) % 4
            e = min(4 * high + low, 48); e_before = e
            gap = e
            if e >= 2:
                m = min(e - 1, 3); gap = 2**m + y.read(dm[e]) % 2**m; rest = e - 1 - m
                while rest: k = min(rest, 15); gap = gap << k | y.bits(k); rest -= k
            key = (key + gap) % 2**(3 * W); b = width[0][g]
            x = [sum((key >> (3 * j + c) & 1) << j for j in range(W)) for c in range(3)]
            code[0].append([(v >> (W - b)) - 2**(b - 1) for v in x])
        y.end()
        for g in range(start, start + n):
            points.append([(k + 2**(width[0][g] - 1)) << (16 - width[0][g]) for k in code[0][g]])
        own = []
        for g in range(start, start + n):
            k = key_of(points[g], 16); own.append((k, g))
            place = sum(1 for c in curve if c[0] < k)
            candidates = list(range(g - 1, max(start, g - 4) - 1, -1)) + [c[1] for c in curve[max(place - 4, 0):place + 4]]
            best = sorted(candidates, key=lambda c: sum((u - v)**2 for u, v in zip(points[g], points[c])))
            neighbors.append(best[:2])
        curve = sorted(curve + own)
        for a in range(1, 5):
            y = Symbols(section(TAGS[a], 65535, layer)); high, middle, numbers = firsts[a]
            for g in range(start, start + n):
                near2 = neighbors[g] + neighbors[g][-1:] if len(neighbors[g]) == 1 else neighbors[g]
                near2 = [[value(a, h, c, code[a][h][c]) for c in range(C[a])] for h in near2] or [[0.0] * C[a]] * 2
                features = [1.0] + near2[0] + near2[1]
                code[a].append([]); r = 1.0; b = width[a][g]
                for c in range(C[a]):
                    step, offset = quantizers[a][b][c]; mode, weights = predictors[a][c]
                    near = lambda x: max(-2**(b - 1), min(2**(b - 1) - 1, nearest((x - offset) / step)))
                    pred = 0.0
                    for x, w in zip(features, weights): pred += x * w
                    if mode == 1:
                        d = abs(near(near2[0][c]) - near(near2[1][c]))
                        k = wrap(near(pred) + signed(numbers.read(y, (c, b, 0 if d == 0 else min(log2(d) + 1, 7)))), b)
                    else:
                        bin = ((near(pred if mode == 0 else math.sqrt(max(r, 0.0))) + 2**(b - 1)) * 16) >> b
                        h = min(b, 4); m = min(b - h, 4)
                        v = y.read(high[c, b, bin]) % 2**h; k = v
                        if m: k = k << m | y.read(middle[c, b, v]) % 2**m
                        k = (k << (b - h - m) | y.bits(b - h - m)) - 2**(b - 1)
                    code[a][g].append(k); x = value(a, g, c, k); r -= x * x; features.append(x)
            y.end()
        start += n
    tracks = [[[([0], [code[a][g][c]]) for c in range(C[a])] for g in range(N)] for a in range(5)]
    joined = [dict() for _ in range(5)]
    for segment in range((T + L - 1) // L):
        A, Z = segment * L, min((segment + 1) * L, T) - 1
        state = [dict(count=Models(16), more=Numbers(), before=Numbers(), after=Numbers(), gaps=Numbers(), first=Numbers(), later=Numbers(), unit={}) for _ in range(5)]
        start = 0
        for layer, n in enumerate(s['layers']):
            for a in (a for a in range(5) if varies[a]):
                body = section(TAGS[a], segment, layer); motion = body[0]; assert motion < 4
                y = Symbols(body[1:]); st = state[a]; last = 0; per = C[a] if joint[a] else 1
                for g in range(start, start + n):
                    for c0 in range(0, C[a], per):
                        if not moves[a][g][c0]: continue
                        nb = next((h for h in neighbors[g] if moves[a][h][c0]), None); b = width[a][g]
                        def at(c, t):
                            times, codes = st['unit'][nb, c0]
                            k = sum(1 for x in times if x <= t)
                            if k == 0: return float(codes[0][c - c0])
                            if k == len(times): return float(codes[-1][c - c0])
                            u, v = float(codes[k - 1][c - c0]), float(codes[k][c - c0])
                            return u + (v - u) * (t - times[k - 1]) / (times[k] - times[k - 1])
                        def scaled(c, d):
                            return d if width[a][nb] == b else d * quantizers[a][width[a][nb]][c][0] / quantizers[a][b][c][0]
                        clamp = lambda x: max(-10**6, min(10**6, nearest(x)))
                        before = st['before'].read(y, 0) if A else 0
                        times = [A - before]; assert times[0] >= 0
                        if A == 0: codes = [code[a][g][c0:c0 + per]]
                        else:
                            sz, row = 0, []
                            for c in range(c0, c0 + per):
                                shift = scaled(c, at(c, times[0]) - code[a][nb][c]) if nb is not None else 0.0
                                z = st['first'].read(y, (c, b, sz)); sz = size(z)
                                row.append(wrap(code[a][g][c] + clamp(shift) + signed(z), b))
                            codes = [row]
                        inner = 0
                        if not (A == Z and before == 0):
                            near = bucket(max(len(st['unit'][nb, c0][0]) - 2, 0)) if nb is not None else 0
                            k = y.read(st['count'][c0, near, bucket(last)])
                            inner = max(k - 1, 0)
                            if k == 15: inner = 14 + st['more'].read(y, 0)
                            t, q = A, max(Z - A - 1, 0); assert inner <= q
                            for i in range(inner, 0, -1):
                                gap = st['gaps'].read(y, min(log2(2 * q // i), 8) - 1) if q > i else 0
                                assert gap <= q - i
                                t += gap + 1; q -= gap + 1; times.append(t)
                            times.append(Z + st['after'].read(y, 0) if Z + 1 < T else Z); assert times[-1] < T
                            if k == 0: codes.append(codes[0])
                            else:
                                sizes = [0] * per
                                for j in range(1, len(times)):
                                    row = []
                                    for c in range(c0, c0 + per):
                                        i = c - c0; u = codes[j - 1][i]
                                        S = scaled(c, at(c, times[j]) - at(c, times[j - 1])) if nb is not None else None
                                        D = float(u - codes[j - 2][i]) * (times[j] - times[j - 1]) / (times[j - 1] - times[j - 2]) if j > 1 else None
                                        if motion == 0: shift = 0.0
                                        elif motion == 1: shift = S if S is not None else 0.0
                                        elif motion == 2: shift = D if D is not None else 0.0
                                        else: shift = (S + D) * 0.5 if None not in (S, D) else S if S is not None else D if D is not None else 0.0
                                        gg = min(log2(max(times[j] - times[j - 1], 1)), 3)
                                        z = st['later'].read(y, (c, b, sizes[i - 1] if i else sizes[0], gg, nb is not None))
                                        sizes[i] = size(z); row.append(wrap(u + clamp(shift) + signed(z), b))
                                    codes.append(row)
                        last = inner
                        st['unit'][g, c0] = (times, codes)
                        old = joined[a].setdefault((g, c0), ([], []))
                        shared = sum(1 for t in old[0] if t >= times[0])
                        assert old[0][len(old[0]) - shared:] == times[:shared] and old[1][len(old[1]) - shared:] == codes[:shared]
                        old[0].extend(times[shared:]); old[1].extend(codes[shared:])
                y.end()
            start += n
    assert next(sections, None) is None
    for a in range(5):
        for (g, c0), (times, codes) in joined[a].items():
            assert times[0] == 0 and times[-1] == T - 1 and times == sorted(set(times))
            for i in range(len(codes[0])): tracks[a][g][c0 + i] = (times, [row[i] for row in codes])
    def at(t):
        out = {}
        for a in range(5):
            rows = []
            for g in range(N):
                row = []
                for c in range(C[a]):
                    times, codes = tracks[a][g][c]
                    k = sum(1 for x in times if x <= t) - 1
                    v = f32(value(a, g, c, codes[k]))
                    if k + 1 < len(times) and times[k] < t:
                        w = f32(value(a, g, c, codes[k + 1]))
                        v = f32(v + f32(f32(w - v) * f32((t - times[k]) / (times[k + 1] - times[k]))))
                    row.append(v)
                if a == 1:
                    def norm(row):
                        total = 0.0
                        for x in row: total = f32(total + f32(x * x))
                        return total
                    length = f32(math.sqrt(norm(row)))
                    if length > 0: row = [f32(x / length) for x in row]
                    if not norm(row) > 0.5: row = [1.0, 0.0, 0.0, 0.0]
                rows += row
            out[NAMES[a]] = rows
        return out
    s['attributes'] = {NAMES[a]: {'varies': bool(varies[a]), 'widths': width[a], 'tracks_of_times_and_codes': [[t, k] for g in tracks[a] for t, k in g]} for a in range(5)}
    s['reconstructed'] = [{'timestep': t, 'values': at(t)} for t in [0, (T - 1) // 2, T - 1]]
    return s

for name in sys.argv[1:]:
    got = decode(open(name, 'rb').read())
    want = json.load(open(name.replace('.tcgs', '.json')))
    for key in want:
        if key == 'reconstructed':
            for g, w in zip(got[key], want[key]):
                for n in NAMES:
                    assert g['values'][n] == [f32(x) for x in w['values'][n]], (name, g['timestep'], n)
        elif key == 'frame_rate': assert f32(want[key]) == got[key]
        else: assert got[key] == want[key], (name, key)
    print(name, 'is what it should be')
