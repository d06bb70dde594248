"""Makes files of version 2 that no encoder writes, from the vectors in v2/: those of refused_v2/, each of which breaks one
rule of docs/FORMAT.md, with their table refused_v2/refused.json; and six vectors that a decoder takes.

Usage:
  forge_v2.py            write all; a vector that exists keeps its bytes
  forge_v2.py --check    decode.py refuses every refused file for the reason in the table; what is there is what is made
"""
import json, pathlib, struct, sys, zlib
sys.dont_write_bytecode = True
import decode as decoder
from forge import beyond, damaged, forge, large, main, replaced, until

FOLDER = pathlib.Path(__file__).parent
HEADER, COHORT, ENTRY = 20, 36, 24

def vector(name): return (FOLDER / 'v2' / f'{name}.tcgs').read_bytes()

def text(name): return struct.pack('<H', len(name)) + name.encode()

# --- Parts of a file
# ---------------------------------------------------------------------------------------------------

class Cohort:
    """Parts of a cohort.

    - `fields`: start, num_timesteps, num_gaussians, plan
    - `head`: its bytes before the table of sections
    - `shared[layer]`, `segments[s][layer]`: sections
    """
    def __init__(self, data, at):
        *self.fields, head_bytes, _, _, offset = struct.unpack_from('<7IQ', data, at)
        self.head_bytes, self.offset = head_bytes, offset
    def read(self, data, cohort):
        layers = lambda group: [[bytearray(body) for _, body, _ in layer] for layer in group]
        self.shared, self.segments = layers(cohort.shared), [layers(segment) for segment in cohort.segments]
        self.starts = [cohort.span(s)[0] + cohort.start for s in range(cohort.num_segments)]
        count = len(self.segments) + sum(map(len, self.shared)) + sum(map(len, sum(self.segments, [])))
        self.head = bytearray(data[self.offset:self.offset + self.head_bytes - 8 * count])

class File:
    """Parts of a file, to be changed; `bytes` lays them out, changes fields, and seals the file with checksums that are
    right.

    - `optional`: pairs of a place and a section (tag, bytes); the place is `first`, `INFO`, `COHO`, a piece, or `last`
    - `order`: of pieces; a piece is its first timestep, its cohort, and 0 or the segment and one
    - `gaps`: bytes before a piece
    - `same`: a piece that lies where another one does
    - `changes`: place (`header`, `INFO`, `COHO`, `cohort`, `head`, `table`, `segment`, with indices), offset, layout of
      struct and values. The place `table` is what follows the plan in a head, `segment` a segment's offset in it
    """
    def __init__(self, name):
        data = vector(name)
        _, cohorts = decoder.open_2(data)
        (info, length), (places, _) = (struct.unpack_from('<QQ', data, HEADER + ENTRY * i + 8) for i in (0, 1))
        self.info = bytearray(data[info:info + length])
        self.cohorts = [Cohort(data, places + 4 + COHORT * i) for i in range(len(cohorts))]
        for own, cohort in zip(self.cohorts, cohorts): own.read(data, cohort)
        self.optional, self.gaps, self.same, self.changes, self.order = [], {}, {}, [], None
        self.more_places, self.more_bytes = b'', 0
    def pieces(self):
        heads = [(cohort.fields[0], i, 0) for i, cohort in enumerate(self.cohorts)]
        return sorted(heads + [(t, i, 1 + s) for i, c in enumerate(self.cohorts) for s, t in enumerate(c.starts[:len(c.segments)])])
    def section_at(self, place):
        """By a place of decode.py: `maps` or the name of an attribute, segment, layer, cohort."""
        name, segment, layer, index = place
        cohort = decoder.open_2(self.bytes())[1][index]
        if segment == decoder.SHARED: return self.cohorts[index].shared[layer][(['maps'] + cohort.plan['names']).index(name)]
        return self.cohorts[index].segments[segment][layer][cohort.names_in_segments().index(name)]

    def bytes(self):
        def table(sections): return b''.join(struct.pack('<II', len(s), zlib.crc32(s)) for s in sections)
        body, at, entries = bytearray(), {}, []
        start = HEADER + ENTRY * (2 + len(self.optional))
        def section(tag, content):
            entries.append((tag, zlib.crc32(content), start + len(body), len(content)))
            at[tag.decode('latin-1')] = start + len(body)
            body.extend(content)
        def optional(place):
            for _, (tag, content) in (o for o in self.optional if o[0] == place): section(tag, content)
        optional('first')
        section(b'INFO', self.info)
        optional('INFO')
        section(b'COHO', bytes(4 + COHORT * len(self.cohorts)) + self.more_places)
        optional('COHO')
        for piece in self.order or self.pieces():
            body.extend(self.gaps.get(piece, b''))
            optional(piece)
            _, index, part = piece
            cohort = self.cohorts[index]
            at[piece] = start + len(body)
            if piece in self.same: at[piece] = at[self.same[piece]]
            elif part > 0: body.extend(b''.join(sum(cohort.segments[part - 1], [])))
            else:
                at['head', index] = start + len(body)
                body.extend(cohort.head)
                at['table', index] = start + len(body)
                body.extend(table(sum(cohort.shared, [])))
                for s, segment in enumerate(cohort.segments):
                    at['segment', index, s] = start + len(body)
                    body.extend(bytes(8) + table(sum(segment, [])))
                at['shared', index] = start + len(body)
                body.extend(b''.join(sum(cohort.shared, [])))
        optional('last')
        body.extend(self.gaps.get('last', b''))
        data = bytearray(b'TCGS' + struct.pack('<HHQI', 2, len(entries), start + len(body) + self.more_bytes, 0))
        data += b''.join(struct.pack('<4sIQQ', *entry) for entry in entries) + body
        at |= {'header': 0}
        struct.pack_into('<I', data, at['COHO'], len(self.cohorts))
        for piece in self.pieces():
            if piece[2] > 0: struct.pack_into('<Q', data, at['segment', piece[1], piece[2] - 1], at[piece])
        for i, cohort in enumerate(self.cohorts):
            at['cohort', i] = at['COHO'] + 4 + COHORT * i
            head, shared = at['head', i], at['shared', i]
            sizes = shared - head, 0, len(b''.join(sum(cohort.shared, [])))
            struct.pack_into('<7IQ', data, at['cohort', i], *cohort.fields, *sizes, head)
        for place, offset, layout, *values in self.changes: struct.pack_into('<' + layout, data, at[place] + offset, *values)
        for i in range(len(self.cohorts)):
            length, = struct.unpack_from('<I', data, at['cohort', i] + 16)
            struct.pack_into('<I', data, at['cohort', i] + 20, zlib.crc32(data[at['head', i]:at['head', i] + length]))
        for i in range(len(entries)):
            offset, length = struct.unpack_from('<QQ', data, HEADER + ENTRY * i + 8)
            struct.pack_into('<I', data, HEADER + ENTRY * i + 4, zlib.crc32(data[offset:offset + length]))
        count, = struct.unpack_from('<H', data, 6)
        struct.pack_into('<I', data, 16, zlib.crc32(data[:16] + data[HEADER:HEADER + ENTRY * count]))
        self.at = at
        return bytes(data)

def changed(name, *changes):
    """A vector with fields changed."""
    file = File(name)
    file.changes += changes
    return file.bytes()

def edited(name, edit):
    """A vector with parts changed."""
    file = File(name)
    edit(file)
    return file.bytes()

def forged(name, *changes):
    """A vector with other symbols in some sections; see forge.py."""
    file = File(name)
    forge(vector(name), file, changes)
    return file.bytes()

def attribute(name, of, offset, layout, *values):
    """A change of a field of an attribute in the plan of a vector's first cohort.

    - `offset`: from the number of its components, which follows its name and its unit
    """
    head = File(name).cohorts[0].head
    at = head.index(text(of)) + len(text(of))
    at += 2 + struct.unpack_from('<H', head, at)[0]
    return ('head', 0), at + offset, layout, *values

def first_byte_of_shared(name):
    file = File(name)
    file.bytes()
    return file.at['shared', 0]

# --- What must be refused
# ----------------------------------------------------------------------------------------------

ONE, COHORTS, LIVES, SPARSE, PLANS, LAYERS, FRAMES = 'one_gaussian', 'cohorts', 'lives', 'sparse', 'shared_plan', 'layers', 'flip_book'

def moved(piece, before):
    """A piece comes before another one, which it should follow."""
    def edit(file):
        file.order = [other for other in file.pieces() if other != piece]
        file.order.insert(file.order.index(before), piece)
    return edit

def twice(file):
    """The only cohort once more, of the same plan."""
    file.cohorts.append(File(LIVES).cohorts[0])
    file.cohorts[1].fields[3] = 0
    # Without its own: the number of layers is one.
    file.cohorts[1].head = file.cohorts[1].head[:11]
    struct.pack_into('<I', file.info, 0, 2 * file.cohorts[0].fields[2])

def overlap(file):
    """A segment of two cohorts that are alike lies at one place."""
    twice(file)
    first, second = [piece for piece in file.pieces() if piece[2] == 2]
    file.same[second] = first

def gap(piece):
    """A byte that belongs to nothing before a piece."""
    def edit(file): file.gaps[piece if piece == 'last' else file.pieces()[piece]] = b'\0'
    return edit

def outside_life(segment, symbol):
    """The first number `before` or `after` of means in a segment that may lead out of a life, but not out of the cohort."""
    cohort = decoder.decode(vector(LIVES)).cohorts[0]
    (first, last), end, skip = cohort.head.span(segment), cohort.head.num_timesteps - 1, 0
    for g, (B, D) in enumerate(cohort.shared.lives):
        A, Z, times = max(first, B), min(last, D), cohort.tracks[0][3 * g][0]
        if not cohort.shared.moves[0][g][0] or A > Z: continue
        if symbol == 'before': is_read, value, within = A > B, A - B + 1, B > 0
        else: is_read, value, within = Z < D and not (A == Z and A in times), D - Z + 1, D < end
        if is_read and within and value < 8: return until(symbol, (symbol, value), skip=skip)
        skip += is_read
    raise AssertionError(f'no such {symbol}')

def with_section(place, tag, content=b''):
    def edit(file): file.optional.append((place, (tag, content)))
    return edit

def with_errors(*errors):
    def edit(file): file.info[-1:] = bytes([len(errors)]) + b''.join(text(name) + struct.pack('<f', x) for name, x in errors)
    return edit

def swap_sections(file):
    """INFO and COHO change places in the table of contents; offsets stay."""
    file.changes += [('header', HEADER, '4s', b'COHO'), ('header', HEADER + ENTRY, '4s', b'INFO')]

def other_unit(file):
    head = file.cohorts[2].head
    at = head.index(text('wetness'))
    head[at:] = head[at:].replace(text('unit of wetness'), text('unit of wetnesS'))

def renamed(file, name, other):
    head = file.cohorts[0].head
    at = head.index(text(name))
    head[at:at + len(text(name))] = text(other)

def with_skipped(file, name, place, varies, coding=14, optional=True):
    """An attribute of a coding that never gets a meaning, in the list of every plan, with sections of any bytes in every layer."""
    flags = varies | optional << 3 | coding << 4
    described = text(name) + text('any unit') + bytes([200, 77, flags]) + struct.pack('<I', 5) + b'\1what'
    plans = {}
    for i, cohort in enumerate(file.cohorts):
        if cohort.fields[3] == i:
            layers, = struct.unpack_from('<H', cohort.head, 5)
            plan = decoder.read_plan_2(decoder.Fields(bytes(cohort.head[7 + 4 * layers:]), 'cohort'))
            names = [listed for listed, _ in plan['listed']]
            cohort.head[7 + 4 * layers] += 1
            at = cohort.head.index(text(names[place])) if place < len(names) else len(cohort.head)
            cohort.head[at:at] = described
            plans[i] = sum(other for _, other in plan['listed'][:place])
        for layer in cohort.shared: layer.insert(1 + place, bytearray(name.encode()))
        for layer in (layer for segment in cohort.segments for layer in segment):
            if varies: layer.insert(plans[cohort.fields[3]], bytearray(b'any bytes'))
    return file

def other_coding(file):
    """The second plan has another coding of what is skipped."""
    with_skipped(file, 'later.thing', 6, True)
    head = [cohort for i, cohort in enumerate(file.cohorts) if cohort.fields[3] == i][1].head
    at = head.index(text('any unit')) + len(text('any unit'))
    head[at + 2] += 1 << 4

def section_in_piece(file):
    """An optional section of two bytes lies in the last segment, which begins where it did."""
    file.optional.append(('last', (b'abcd', b'')))
    file.bytes()
    piece = file.pieces()[-1]
    file.changes += [('header', HEADER + 2 * ENTRY + 8, 'QQ', file.at[piece] + 1, 2)]

def refused():
    """Name, kind, section, field, what is wrong, bytes."""
    one, entry = vector(ONE), HEADER
    cohort = lambda i: ('cohort', i)
    head = 'head', 0
    first = File(COHORTS)
    first.bytes()
    start_of_second = first.at['head', 1]
    skipped = edited(SPARSE, lambda f: with_skipped(f, 'later.thing', 6, True))
    with_optional = edited(ONE, with_section('last', b'abcd', b'skip me'))
    # The header. An entry of its table: tag, checksum, offset, length.
    yield 'length', 'format', 'file', 'end', 'the header says a byte more than there is', edited(ONE, lambda f: setattr(f, 'more_bytes', 1))
    yield 'longer', 'format', 'file', 'end', 'a byte follows the end that the header says', one + b'\0'
    yield 'cut_in_table', 'format', 'file', 'end', 'the file ends in the table of contents', one[:40]
    yield 'cut_in_cohorts', 'format', 'file', 'end', 'the file ends in COHO', one[:HEADER + 2 * ENTRY + len(File(ONE).info) + 9]
    yield 'header_checksum', 'format', 'header', 'checksum', 'a bit of the table of contents is flipped', damaged(one, entry + 9)
    yield 'sections', 'format', 'header', 'tag', 'COHO comes before INFO', edited(ONE, swap_sections)
    yield 'missing_section', 'format', 'header', 'tag', 'no COHO, but an optional section', changed(ONE, ('header', entry + ENTRY, '4s', b'coho'))
    yield 'section_too_many', 'format', 'header', 'tag', 'a second INFO', edited(ONE, with_section('last', b'INFO', bytes(File(ONE).info)))
    yield 'unknown_tag', 'format', 'header', 'tag', 'a section XTRA, which is not optional', edited(ONE, with_section('last', b'XTRA'))
    yield 'section_within_header', 'format', 'header', 'offset', 'INFO begins in the header', changed(ONE, ('header', entry + 8, 'Q', 60))
    yield 'sections_overlap', 'format', 'header', 'offset', 'COHO begins in INFO', changed(ONE, ('header', entry + ENTRY + 8, 'Q', HEADER + 2 * ENTRY + 9))
    yield 'section_beyond_end', 'format', 'header', 'offset', 'an optional section reaches past the end', changed(ONE, ('header', entry + ENTRY + 16, 'Q', len(one)))
    yield 'offset_overflows', 'format', 'header', 'offset', 'offset and length of COHO add up to more than 2^64', changed(ONE, ('header', entry + ENTRY + 16, 'Q', 2**64 - 9))
    yield 'skipped_checksum', 'format', 'unknown section', 'checksum', 'a bit of an optional section is flipped', damaged(with_optional, len(with_optional) - 1)
    # INFO.
    yield 'timesteps', 'format', 'info', 'num_timesteps', 'no timesteps', changed('no_cohorts', ('INFO', 4, 'I', 0))
    yield 'error_of_nan', 'format', 'info', 'error', 'a declared error of NaN', edited(ONE, with_errors(('means', float('nan'))))
    yield 'negative_error', 'format', 'info', 'error', 'a negative declared error', edited(ONE, with_errors(('means', 0.5), ('quats', -0.5)))
    yield 'info_longer', 'format', 'info', 'end', 'a byte follows the last field of INFO', edited(ONE, lambda f: f.info.append(0))
    yield 'gaussians', 'limit', 'limit', 'limit', '4,294,967,295 Gaussians', changed(ONE, ('INFO', 0, 'I', 2**32 - 1))
    # COHO. A cohort: start, timesteps, Gaussians, plan, bytes and checksum of the head, bytes of shared layers, offset.
    yield 'cohorts_checksum', 'format', 'cohorts', 'checksum', 'a bit of COHO is flipped', damaged(one, first.at['COHO'] + 4)
    yield 'number_of_cohorts', 'format', 'cohorts', 'number of cohorts', '2^20 + 1 cohorts', changed(ONE, ('COHO', 0, 'I', 2**20 + 1))
    yield 'cohorts_shorter', 'format', 'cohorts', 'start', 'one cohort more than COHO has', changed(ONE, ('COHO', 0, 'I', 2))
    yield 'cohorts_longer', 'format', 'cohorts', 'end', 'a byte follows the last cohort in COHO', edited(ONE, lambda f: setattr(f, 'more_places', b'\0'))
    yield 'cohorts_descend', 'format', 'cohorts', 'start', 'the second cohort begins before the first', changed(COHORTS, (cohort(0), 0, 'I', 4))
    yield 'no_timesteps', 'format', 'cohorts', 'num_timesteps', 'a cohort of no timesteps', changed(FRAMES, (cohort(0), 4, 'I', 0))
    yield 'beyond_the_scene', 'format', 'cohorts', 'num_timesteps', 'a cohort lasts longer than the scene', changed(ONE, ('INFO', 4, 'I', 2))
    yield 'start_overflows', 'format', 'cohorts', 'num_timesteps', 'a cohort begins at timestep 2^32 - 1', changed(ONE, (cohort(0), 0, 'I', 2**32 - 1))
    yield 'no_gaussians', 'format', 'cohorts', 'num_gaussians', 'a cohort without Gaussians', changed(ONE, (cohort(0), 8, 'I', 0))
    yield 'more_gaussians', 'format', 'cohorts', 'num_gaussians', 'the scene has one Gaussian more than all cohorts', changed(ONE, ('INFO', 0, 'I', 2))
    yield 'plan_of_later', 'format', 'cohorts', 'plan', 'the plan of a later cohort', changed(PLANS, (cohort(1), 12, 'I', 2))
    yield 'plan_of_sharer', 'format', 'cohorts', 'plan', 'the plan of a cohort that has none of its own', changed(PLANS, (cohort(4), 12, 'I', 1))
    yield 'plan_of_none', 'format', 'cohorts', 'plan', 'the plan of a cohort that there is not', changed(ONE, (cohort(0), 12, 'I', 1))
    yield 'head_before_cohorts', 'format', 'cohorts', 'offset', 'a head in INFO', changed(ONE, (cohort(0), 28, 'Q', HEADER + 2 * ENTRY))
    yield 'heads_overlap', 'format', 'cohorts', 'offset', 'a head in the shared layers of the cohort before', changed(COHORTS, (cohort(1), 28, 'Q', first.at['shared', 0] + 9))
    yield 'head_beyond_end', 'format', 'cohorts', 'offset', 'shared layers that reach past the end', changed(ONE, (cohort(0), 24, 'I', 2**32 - 1))
    yield 'offset_of_head_overflows', 'format', 'cohorts', 'offset', 'a head at 2^64 - 9', changed(ONE, (cohort(0), 28, 'Q', 2**64 - 9))
    # Heads.
    yield 'head_checksum', 'format', 'cohort', 'checksum', 'a bit of the head of the second cohort is flipped', damaged(vector(COHORTS), start_of_second + 30)
    yield 'head_empty', 'format', 'cohort', 'flags', 'a head of no bytes', changed(ONE, (cohort(0), 16, 'I', 0))
    yield 'flags', 'format', 'cohort', 'flags', 'a flag of a cohort that is not known', changed(ONE, (head, 0, 'B', 0x80))
    yield 'mixed_antialiasing', 'format', 'cohort', 'flags', 'the second cohort is antialiased, the first is not', changed(COHORTS, (('head', 1), 0, 'B', 2))
    yield 'segment_length', 'format', 'cohort', 'segment_length', 'segments of no timesteps', changed(ONE, (head, 1, 'I', 0))
    yield 'layers', 'format', 'cohort', 'layers', 'the layer holds more Gaussians than the cohort', changed(ONE, (head, 7, 'I', 2))
    yield 'empty_layer', 'format', 'cohort', 'layers', 'a layer without Gaussians', changed(LAYERS, (head, 7, 'II', 0, 12))
    yield 'too_many_segments', 'format', 'cohort', 'segment_length', '65,536 segments', changed(ONE, ('INFO', 4, 'I', 65_536), (cohort(0), 0, 'II', 0, 65_536), (head, 1, 'I', 1))
    yield 'four_attributes', 'format', 'cohort', 'number of attributes', 'no colours', changed(ONE, (head, 11, 'B', 4))
    yield 'other_attribute', 'format', 'cohort', 'name of an attribute', 'the first attribute is not means', changed(ONE, (head, 14, '5s', b'meanS'))
    yield 'other_components', 'format', 'cohort', 'name of an attribute', 'opacities of two components', changed(ONE, attribute(ONE, 'logit_opacities', 0, 'B', 2))
    yield 'other_activation', 'format', 'cohort', 'name of an attribute', 'scales that are not activated by exp', changed(ONE, attribute(ONE, 'log_scales', 1, 'B', 0))
    yield 'same_name', 'format', 'cohort', 'name of an attribute', 'two attributes of one name', edited(SPARSE, lambda f: renamed(f, 'label', 'means'))
    yield 'no_components', 'format', 'cohort', 'components', 'an attribute of no components', changed(SPARSE, attribute(SPARSE, 'wetness', 0, 'B', 0))
    yield 'components', 'format', 'cohort', 'components', 'an attribute of 33 components', changed(LAYERS, attribute(LAYERS, 'spectrum', 0, 'B', 33))
    yield 'activation', 'format', 'cohort', 'activation', 'activation 255', changed(SPARSE, attribute(SPARSE, 'glow', 1, 'B', 255))
    yield 'coding', 'format', 'cohort', 'coding of an attribute', 'an attribute that is not optional, of a coding that is not known', edited(SPARSE, lambda f: with_skipped(f, 'later.thing', 6, True, optional=False))
    yield 'coding_of_means', 'format', 'cohort', 'coding of an attribute', 'means of a coding that is not known, and optional', changed(ONE, attribute(ONE, 'means', 2, 'B', 0xea))
    yield 'optional_means', 'format', 'cohort', 'flags of an attribute', 'means are optional', changed(ONE, attribute(ONE, 'means', 2, 'B', 0x0a))
    yield 'length_of_attribute', 'format', 'cohort', 'length of an attribute', 'an attribute to skip that reaches past the end of the head', changed(SPARSE, attribute(SPARSE, 'glow', 2, 'BI', 0xe8, 2**32 - 1))
    yield 'name_of_skipped', 'format', 'cohort', 'name of an attribute', 'an attribute has the name of one to skip', edited(SPARSE, lambda f: with_skipped(with_skipped(f, 'later.thing', 6, True), 'later.thing', 5, False))
    yield 'skipped_attribute', 'format', 'skipped attribute', 'checksum', 'a bit of a section of an attribute to skip is flipped', damaged(skipped, skipped.index(b'any bytes'))
    yield 'other_coding', 'format', 'cohort', 'attributes', 'an attribute to skip has another coding in a later cohort', edited(PLANS, other_coding)
    yield 'lacking_means', 'format', 'cohort', 'flags of an attribute', 'Gaussians may lack their means', changed(ONE, attribute(ONE, 'means', 2, 'B', 4))
    yield 'width', 'format', 'cohort', 'quantizer', 'codes of no bits', changed(SPARSE, attribute(SPARSE, 'wetness', 5, 'B', 0))
    yield 'other_attributes', 'format', 'cohort', 'attributes', 'an attribute of another unit in a later cohort', edited(PLANS, other_unit)
    yield 'head_longer', 'format', 'cohort', 'sections', 'eight bytes too many in a head', edited(ONE, lambda f: f.cohorts[0].head.extend(bytes(8)))
    yield 'shared_length', 'format', 'cohort', 'length', 'sections of shared layers are longer than COHO says', changed(ONE, (cohort(0), 24, 'I', 1))
    yield 'segment_within_shared', 'format', 'cohort', 'offset of a segment', 'a segment begins in the shared layers', changed(ONE, (('segment', 0, 0), 0, 'Q', first_byte_of_shared(ONE)))
    yield 'segment_order', 'format', 'cohort', 'offset of a segment', 'a segment begins before the one before it', edited(COHORTS, moved((4, 0, 2), (0, 0, 1)))
    # Order and cover.
    yield 'gap_before_pieces', 'format', 'file', 'end', 'a byte of nothing before the first piece', edited(COHORTS, gap(0))
    yield 'gap', 'format', 'file', 'end', 'a byte of nothing between two pieces', edited(COHORTS, gap(3))
    yield 'gap_at_end', 'format', 'file', 'end', 'a byte of nothing after the last piece', edited(COHORTS, gap('last'))
    yield 'overlap', 'format', 'file', 'end', 'two cohorts share the bytes of a segment', edited(LIVES, overlap)
    yield 'section_in_piece', 'format', 'file', 'end', 'an optional section lies in a segment', edited(ONE, section_in_piece)
    yield 'order', 'format', 'file', 'end', 'a segment comes before one of another cohort that is needed earlier', edited(COHORTS, moved((8, 0, 3), (7, 1, 2)))
    yield 'order_of_heads', 'format', 'file', 'end', 'a segment comes before a cohort that is needed earlier', edited(COHORTS, moved((4, 0, 2), (3, 1, 0)))
    yield 'order_of_cohorts', 'format', 'file', 'end', 'a cohort comes before a segment of the cohort before', edited(COHORTS, moved((3, 2, 0), (3, 1, 1)))
    yield 'segment_beyond_end', 'format', 'cohort', 'offset of a segment', 'the last segment ends beyond the end of the file', changed(ONE, (('segment', 0, 0), 0, 'Q', len(one) - 8))
    yield 'segment_at_infinity', 'format', 'cohort', 'offset of a segment', 'a segment at 2^64 - 1', changed(ONE, (('segment', 0, 0), 0, 'Q', 2**64 - 1))
    # Sections of cohorts.
    maps = 'maps', decoder.SHARED, 0, 0
    yield 'section_checksum', 'format', 'maps', 'checksum', 'a bit of the maps is flipped', damaged(one, first_byte_of_shared(ONE))
    yield 'birth', 'format', 'maps', 'lives', 'a life that begins after the cohort', forged(LIVES, (maps, until('birth', *large('birth'), ('left', 0))))
    yield 'death', 'format', 'maps', 'lives', 'a life that ends before it begins', forged(LIVES, (maps, until('birth', ('birth', 7), *large('left'))))
    means = 'means', 2, 0, 0
    yield 'before_life', 'format', 'means', 'keypoint times', 'a keypoint before the life of its Gaussian', forged(LIVES, (means, outside_life(2, 'before')))
    yield 'after_life', 'format', 'means', 'keypoint times', 'a keypoint after the life of its Gaussian', forged(LIVES, (means, outside_life(2, 'after')))
    yield 'symbol_too_many', 'format', 'further attribute', 'symbols', 'a symbol too many of a further attribute', forged(SPARSE, (('wetness', decoder.SHARED, 0, 0), lambda seen: seen + [('extra', 1)]))
    yield 'disagreement', 'format', 'means', 'keypoints', 'two segments disagree on the code of a keypoint that they share', forged(COHORTS, (('means', 1, 0, 0), replaced('first', lambda u: u ^ 1 if u < 8 else u)))

# --- What a decoder takes
# ----------------------------------------------------------------------------------------------

def optional_sections():
    """Sections to skip at the start, between pieces and at the end; data of applications, one piece without a name."""
    credits = json.dumps({'licence': 'CC0-1.0', 'authors': ['nobody'], 'source': 'made by a program'}).encode()
    def edit(file):
        pieces = file.pieces()
        file.optional += [('first', (b'abcd', b'skip me')), ('INFO', (b'1+1=', b'two')), ('COHO', (b'appl', text('tcgs.credits') + credits))]
        file.optional += [('COHO', (b'appl', b'\2\0\xff\xfe')), (pieces[3], (b'appl', text('notes') + b'between'))]
        file.optional += [(pieces[4], (b'none', b'')), ('last', (b'appl', text('notes') + b'last')), ('last', (b'zzzz', b''))]
    return edited(COHORTS, edit)

def declared_errors():
    """Largest differences to what was compressed, also of an attribute that there is not."""
    return edited('harmonics', with_errors(('means', 0.0), ('sh1', 0.125), ('colors', 0.01), ('wetness', 3.0)))

def skipped():
    """Optional attributes of codings that nobody knows, between others and at the end."""
    return edited(PLANS, lambda f: with_skipped(with_skipped(f, 'later.still', 6, False, coding=15), 'later.thing', 5, True))

def skipped_motion():
    """Only what is skipped varies, so that there are three segments."""
    def edit(file):
        cohort, = file.cohorts
        length, = struct.unpack_from('<I', cohort.head, 1)
        cohort.starts = list(range(cohort.fields[0], cohort.fields[0] + cohort.fields[1], length))
        cohort.segments = [[[] for _ in cohort.shared] for _ in cohort.starts]
        with_skipped(file, 'later.thing', 5, True)
    return edited('still', edit)

def symbols_beyond():
    """Symbols beyond those that are said."""
    return forged(SPARSE, (('maps', decoder.SHARED, 0, 0), beyond), (('means', decoder.SHARED, 0, 0), beyond))

def born_and_gone():
    """Tracks that move in lives of one timestep: they have one keypoint each. No encoder says so of them."""
    shared = decoder.decode(vector(LIVES)).cohorts[0].shared
    # Not those that others are predicted from.
    neighbors = {h for of in shared.neighbors for h in of}
    short = [B == D and g not in neighbors for g, (B, D) in enumerate(shared.lives)]
    assert any(short)
    def edit(seen):
        # Of each Gaussian the symbols of its moves follow those of its life and its widths.
        out, gaussian = [], -1
        for name, value in seen:
            gaussian += name == 'birth'
            out.append((name, 1) if name == 'moves' and short[gaussian] else (name, value))
        return out
    return forged(LIVES, (('maps', decoder.SHARED, 0, 0), edit))

if __name__ == '__main__':
    forged_vectors = optional_sections, declared_errors, skipped, skipped_motion, symbols_beyond, born_and_gone
    main(sys.argv[1:], list(refused()), forged_vectors, FOLDER / 'refused_v2', FOLDER / 'v2')
