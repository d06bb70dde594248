"""Makes files of version 1 that no encoder writes, from the vectors in v1/: those of refused/, each of which breaks one rule of
docs/FORMAT.md, with their table refused/refused.json; and two vectors that a decoder takes.

Usage:
  forge.py            write all; a vector that exists keeps its bytes
  forge.py --check    decode.py refuses every refused file for the reason in the table; what is there is what is made
"""
import json, pathlib, struct, sys, zlib
sys.dont_write_bytecode = True
import decode as decoder

FOLDER = pathlib.Path(__file__).parent

# --- Parts of a file
# ---------------------------------------------------------------------------------------------------

class File:
    """Sections of a file, to be changed; `bytes` seals it with checksums that are right."""
    def __init__(self, name):
        data = vector(name)
        self.sections, at = [], 16 + 16 * struct.unpack_from('<I', data, 8)[0]
        for entry in range(16, at, 16):
            tag, segment, layer, length = struct.unpack_from('<4sHHI', data, entry)
            self.sections.append([tag, segment, layer, bytearray(data[at:at + length])])
            at += length
    def section(self, tag, segment=decoder.SHARED, layer=0):
        return next(s[3] for s in self.sections if tuple(s[:3]) == (tag, segment, layer))
    def section_at(self, place):
        """By a place of decode.py: `maps` or the name of an attribute, segment, layer, cohort."""
        name, segment, layer, _ = place
        return self.section(dict(zip(decoder.NAMES, decoder.TAGS), maps=b'MAPS')[name], segment, layer)
    def bytes(self):
        table = b''.join(struct.pack('<4sHHII', *s[:3], len(s[3]), zlib.crc32(s[3])) for s in self.sections)
        start = b'TCGS' + struct.pack('<HHI', 1, 0, len(self.sections))
        return start + struct.pack('<I', zlib.crc32(start + table)) + table + b''.join(s[3] for s in self.sections)

def vector(name): return (FOLDER / 'v1' / f'{name}.tcgs').read_bytes()

def patched(name, *changes):
    """A vector with bytes of a section changed: (tag, offset, format of struct, values...)."""
    file = File(name)
    for tag, offset, layout, *values in changes: struct.pack_into('<' + layout, file.section(tag), offset, *values)
    return file.bytes()

def with_header(data, offset, layout, value):
    """A file with a field of its header changed, and the header's checksum right."""
    data = bytearray(data)
    struct.pack_into('<' + layout, data, offset, value)
    end = 16 + 16 * min(struct.unpack_from('<I', data, 8)[0], (len(data) - 16) // 16)
    struct.pack_into('<I', data, 12, zlib.crc32(data[:12] + data[16:end]))
    return bytes(data)

# --- Symbols
# -----------------------------------------------------------------------------------------------------------

class Recorder(decoder.Symbols):
    """Notes what is read: the name of the model, or `bits`, and the value."""
    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.seen = []
    def read(self, model):
        symbol = super().read(model)
        self.seen.append((model.name, symbol))
        return symbol
    def bits(self, count):
        value = super().bits(count)
        if count > 0: self.seen.append(('bits', value))
        return value

class Writer:
    """Gives a decoder symbols of our choice, and encodes them as it goes."""
    def __init__(self, values): self.values, self.intervals = list(values), []
    def next(self, name):
        found, value = self.values.pop(0)
        assert found == name, f'{found}, expected {name}'
        return value
    def read(self, model):
        symbol = self.next(model.name)
        self.intervals.append(model.interval(symbol))
        model.learn(symbol)
        return symbol
    def bits(self, count):
        if count == 0: return 0
        value = self.next('bits')
        self.intervals.append((value << (15 - count), 1 << (15 - count)))
        return value
    def end(self):
        # A symbol too many.
        for _, value in self.values: self.intervals.append((value << 14, 1 << 14))
    def bytes(self):
        """rANS: from the last symbol to the first."""
        x, words = 2**31, []
        for start, length in reversed(self.intervals):
            if x >= length << 48:
                words.append(x % 2**32)
                x >>= 32
            x = (x // length << 15) + x % length + start
        return struct.pack('<Q', x) + b''.join(struct.pack('<I', word) for word in reversed(words))

def forged(name, *changes, file=None):
    """A vector with other symbols in some sections.

    - `file`: the vector with other fields, if these change
    - `changes`: pairs of a place, as decode.py names it, and an edit: from the symbols that are read, (name of the model,
      value) each, to others
    """
    file = file or File(name)
    forge(vector(name), file, changes)
    return file.bytes()

def forge(original, file, changes):
    """Changes the symbols of a file's sections; see `forged`."""
    recorders = {}
    def recording(place, body):
        recorder = Recorder(body, decoder.name_in_errors(place[0]))
        return recorders.setdefault(place, recorder)
    decoder.decode(original, recording)
    writers = {place: Writer(edit(recorders[place].seen)) for place, edit in changes}
    writing = lambda place, body: writers.get(place) or decoder.Symbols(body, decoder.name_in_errors(place[0]))
    try: decoder.decode(file.bytes(), writing)
    except decoder.Refused: pass
    for place, writer in writers.items():
        motion = 0 if place[1] == decoder.SHARED else 1
        file.section_at(place)[motion:] = writer.bytes()

def until(name, *values, skip=0):
    """The symbols before one of a model, and others in its place; a decoder is to refuse the last."""
    def edit(seen):
        places = [i for i, (found, _) in enumerate(seen) if found == name]
        return seen[:places[skip]] + list(values)
    return edit

def replaced(name, change):
    """The first symbol of a model that `change` gives another value for."""
    def edit(seen):
        at = next(i for i, (found, value) in enumerate(seen) if found == name and change(value) != value)
        return seen[:at] + [(name, change(seen[at][1]))] + seen[at + 1:]
    return edit

def large(name):
    """The number 40,000."""
    return [(name, 14), (name + ' exponent', 9), (name + ' leading', (40_000 - 2**15) >> 12), ('bits', (40_000 - 2**15) % 2**12)]

# --- What must be refused
# ----------------------------------------------------------------------------------------------

def with_plan_of(name, change):
    file = File(name)
    change(file.section(b'PLAN'))
    return file.bytes()

def resized(name, tag, change):
    file = File(name)
    body = file.section(tag)
    body[:] = change(body)
    return file.bytes()

def reordered(name, change):
    file = File(name)
    change(file.sections)
    return file.bytes()

def damaged(data, at): return data[:at] + bytes([data[at] ^ 1]) + data[at + 1:]

def descending(plan):
    """The first two widths of means change places; each has 24 bytes of quantizers."""
    plan[4], plan[29] = plan[29], plan[4]

# Of the small vectors: the one of one Gaussian, and one of segments of one timestep.
ONE, SHORT, LAYERS, ROOM = 'one_gaussian', 'one_timestep_segments', 'layers_and_segments', 'room_default'

def refused():
    """Name, kind, section, field, what is wrong, bytes."""
    one = vector(ONE)
    info, plan = b'INFO', b'PLAN'
    second = ('means', 1, 0, 0)
    # Section tag, offset of the field, layout, value. Offsets of PLAN: flags, then of means interpolation, number of
    # widths, width, step, offset, ...; the mode of the first component of quats lies at 65.
    yield 'magic', 'format', 'header', 'magic', 'does not begin with TCGS', b'PLY ' + one[4:]
    yield 'version', 'version', 'version', 'version', 'version 65535, which no decoder knows', with_header(one, 4, 'H', 65535)
    yield 'reserved', 'format', 'header', 'reserved', 'the reserved field is 1', with_header(one, 6, 'H', 1)
    yield 'section_count', 'format', 'header', 'number of sections', '2^20 + 1 sections', with_header(one, 8, 'I', 2**20 + 1)
    yield 'header_checksum', 'format', 'header', 'checksum', 'a bit of the table of contents is flipped', damaged(one, 26)
    yield 'cut', 'format', 'file', 'end', 'the last byte is missing', one[:-1]
    yield 'cut_in_table', 'format', 'file', 'end', 'the file ends in the table of contents', one[:100]
    yield 'longer', 'format', 'file', 'end', 'a byte follows the last section', one + b'\0'
    yield 'length', 'format', 'file', 'end', 'the last section reaches past the end', with_header(one, 16 + 16 * 8 + 8, 'I', 2**32 - 1)
    yield 'section_checksum', 'format', 'maps', 'checksum', 'a bit of MAPS is flipped', damaged(one, one.index(bytes(File(ONE).section(b'MAPS'))))
    optional = reordered(ONE, lambda s: s.append([b'abcd', 0, 0, b'skip me']))
    yield 'skipped_checksum', 'format', 'unknown section', 'checksum', 'a bit of an optional section is flipped', damaged(optional, len(optional) - 1)
    yield 'unknown_tag', 'format', 'header', 'tag', 'a section XTRA, which is not optional', reordered(ONE, lambda s: s.append([b'XTRA', 0, 0, b'']))
    yield 'order', 'format', 'header', 'tag', 'PLAN comes before INFO', reordered(ONE, lambda s: s.insert(0, s.pop(1)))
    yield 'missing_section', 'format', 'header', 'tag', 'the colours of the shared layer are missing', reordered(ONE, lambda s: s.pop(7))
    yield 'section_too_many', 'format', 'header', 'tag', 'a second INFO at the end', reordered(ONE, lambda s: s.append(s[0]))
    yield 'segment_number', 'format', 'header', 'tag', 'the only segment has the number 1', reordered(ONE, lambda s: s[8].__setitem__(1, 1))

    yield 'gaussians', 'limit', 'limit', 'limit', '4,294,967,295 Gaussians', patched(ONE, (info, 0, 'I', 2**32 - 1))
    end = len(File(ONE).section(info)) - 4
    yield 'memory', 'limit', 'limit', 'limit', '16,000,000 Gaussians in less than a kilobyte', patched(ONE, (info, 0, 'I', 16_000_000), (info, end, 'I', 16_000_000))
    yield 'timesteps', 'format', 'info', 'num_timesteps', 'no timesteps', patched(ONE, (info, 4, 'I', 0))
    yield 'downscale', 'format', 'info', 'downscale', 'a downscale of 0', patched(ONE, (info, 12, 'I', 0))
    yield 'frame_rate', 'format', 'info', 'frame_rate', 'NaN frames per second', patched(ONE, (info, 16, 'f', float('nan')))
    yield 'bounds', 'format', 'info', 'bounds', 'the smallest x is above the largest', patched(ONE, (info, 20, 'f', 1e9))
    yield 'infinite_bounds', 'format', 'info', 'bounds', 'the largest z is infinite', patched(ONE, (info, 40, 'f', float('inf')))
    yield 'color_space', 'format', 'info', 'color_space', 'colour space 2', patched(ONE, (info, 44, 'B', 2))
    yield 'up', 'format', 'info', 'up', 'axis 7 points up', patched(ONE, (info, 45, 'B', 7))
    yield 'name', 'format', 'info', 'generator', 'a text that is not UTF-8', patched(ONE, (info, 50, 'B', 0xff))
    yield 'overlong', 'format', 'info', 'generator', 'a text of UTF-8 in an overlong form', patched(ONE, (info, 50, '2s', b'\xc0\x80'))
    yield 'surrogate', 'format', 'info', 'generator', 'a text with a surrogate', patched(ONE, (info, 50, '3s', b'\xed\xa0\x80'))
    yield 'long_name', 'format', 'info', 'name', 'a text that reaches past the section', patched(ONE, (info, 46, 'H', 9999))
    yield 'layers', 'format', 'info', 'layers', 'the layers hold more Gaussians than there are', patched(ONE, (info, end, 'I', 2))
    yield 'empty_layer', 'format', 'info', 'layers', 'a layer without Gaussians', resized(ONE, info, lambda b: b[:end - 2] + b'\2\0' + b[end:] + bytes(4))
    yield 'segment_length', 'format', 'info', 'segment_length', 'segments of no timesteps', patched(ONE, (info, end - 6, 'I', 0))
    yield 'too_many_segments', 'format', 'info', 'segment_length', '65,536 segments', patched(ONE, (info, 4, 'I', 65536), (info, end - 6, 'I', 1))
    yield 'info_longer', 'format', 'info', 'end', 'a byte follows the last field of INFO', resized(ONE, info, lambda b: b + b'\0')

    yield 'varying_sixth', 'format', 'plan', 'varying attributes', 'a sixth attribute varies', patched(ONE, (plan, 0, 'B', 0x28))
    yield 'joint_eighth', 'format', 'plan', 'joint attributes', 'an eighth attribute is joint', patched(ONE, (plan, 1, 'B', 0x80))
    yield 'interpolation', 'format', 'plan', 'interpolation', 'interpolation 1', patched(ONE, (plan, 2, 'B', 1))
    yield 'width', 'format', 'plan', 'quantizer', 'codes of 17 bits', patched(ONE, (plan, 4, 'B', 17))
    yield 'descending_widths', 'format', 'plan', 'width', 'widths that descend', with_plan_of(SHORT, descending)
    yield 'step', 'format', 'plan', 'quantizer', 'a step of 0', patched(ONE, (plan, 5, 'f', 0.0))
    yield 'offset', 'format', 'plan', 'quantizer', 'an infinite offset', patched(ONE, (plan, 9, 'f', float('-inf')))
    yield 'mode', 'format', 'plan', 'mode', 'mode 3', patched(ONE, (plan, 64, 'B', 3))
    yield 'weight', 'format', 'plan', 'weight', 'a weight of NaN', patched(ONE, (plan, 65, 'f', float('nan')))
    yield 'plan_shorter', 'format', 'plan', 'weight', 'PLAN ends within a weight', resized(ONE, plan, lambda b: b[:-1])

    yield 'widths', 'format', 'maps', 'bit widths', 'a width that has no quantizers', patched(ONE, (plan, 4, 'B', 5))
    yield 'state', 'format', 'maps', 'symbols', 'a first state below 2^31', patched(ONE, (b'MAPS', 0, 'Q', 2**31 - 1))
    yield 'large_state', 'format', 'maps', 'symbols', 'a first state of 2^63', patched(ONE, (b'MAPS', 0, 'Q', 2**63))
    yield 'short_state', 'format', 'colors', 'symbols', 'seven bytes for the first state', resized(ONE, b'COLR', lambda b: b[:7])
    yield 'word_missing', 'format', 'means', 'symbols', 'the last word is missing', resized(LAYERS, b'MEAN', lambda b: b[:-4])
    yield 'word_too_many', 'format', 'means', 'symbols', 'a word too many', resized(LAYERS, b'MEAN', lambda b: b + bytes(4))
    yield 'half_word', 'format', 'means', 'symbols', 'two bytes after the last word', resized(LAYERS, b'MEAN', lambda b: b + bytes(2))
    yield 'symbol_too_many', 'format', 'quats', 'symbols', 'a symbol too many: the last state is not 2^31', forged(ONE, (('quats', decoder.SHARED, 0, 0), lambda seen: seen + [('extra', 1)]))
    opac = File(ONE)
    opac.section(b'OPAC', 0)[0] = 4
    yield 'motion', 'format', 'logit_opacities', 'motion', 'motion 4', opac.bytes()
    opac.section(b'OPAC', 0)[:] = b''
    yield 'no_motion', 'format', 'logit_opacities', 'motion', 'a section of a segment without a byte', opac.bytes()
    yield 'before', 'format', 'means', 'keypoint times', 'a first keypoint before timestep 0', forged(SHORT, (second, until('before', *large('before'))))
    yield 'inner', 'format', 'means', 'keypoint times', 'an inner keypoint where there is no timestep', forged(SHORT, (second, until('count', ('count', 2))))
    yield 'many_inner', 'format', 'means', 'keypoint times', 'more than 40,000 inner keypoints', forged(LAYERS, (('means', 0, 1, 0), until('count', ('count', 15), *large('more'))))
    yield 'gap', 'format', 'log_scales', 'keypoint times', 'a gap larger than what is left', forged(LAYERS, (('log_scales', 0, 0, 0), until('gap', ('gap', 7))))
    yield 'after', 'format', 'means', 'keypoint times', 'a last keypoint after the last timestep', forged(SHORT, (second, until('after', ('after', 7))))
    yield 'disagreement', 'format', 'means', 'keypoints', 'two segments disagree on the code of a keypoint that they share', forged(SHORT, (second, replaced('first', lambda u: u ^ 1 if u < 8 else u)))

# --- What a decoder takes
# ----------------------------------------------------------------------------------------------

def optional_sections():
    """Sections to skip, wherever they may be; data of applications, one piece without a name."""
    view = {'name': 'front', 'width': 64, 'height': 48, 'focal': [50, 50], 'principal': [32, 24], 'position': [0, 0, -3], 'rotation': [1, 0, 0, 0]}
    views = json.dumps({'views': [view, {'unknown': True}]}).encode()
    def change(sections):
        sections.insert(2, [b'appl', decoder.SHARED, 0, struct.pack('<H', 10) + b'tcgs.views' + views])
        sections.insert(3, [b'appl', decoder.SHARED, 0, b'\2\0\xff\xfe'])
        sections.insert(7, [b'1+1=', 7, 9, b'two'])
        sections.insert(0, [b'abcd', 3, 65535, b'skip me'])
        sections.append([b'zzzz', 0, 0, b''])
    return reordered(ONE, change)

def beyond(seen):
    """Every other symbol of some models, raised by the number of values that it has."""
    values = {'moves': 2, 'present': 2, 'gap low': 4, 'gap leading': 8}
    raised = lambda i, name, value: value + values[name] if name in values and i % 2 == 0 and value + values[name] < 16 else value
    return [(name, raised(i, name, value)) for i, (name, value) in enumerate(seen)]

def layers_of(name): return range(len(decoder.decode(vector(name)).info['layers']))

def symbols_beyond():
    """Symbols beyond those that are said."""
    name = 'one_timestep'
    return forged(name, *[((section, decoder.SHARED, i, 0), beyond) for section in ('maps', 'means') for i in layers_of(name)])

def dropped_bits():
    """Positions of 4 bits where the widest are of 6, with dropped bits that are not 0."""
    name = 'crowd'
    file = File(name)
    plan = file.section(b'PLAN')
    assert plan[3:5] == b'\1\4'
    plan[3:29] = b'\2\4' + plan[5:29] + b'\6' + struct.pack('<6f', *[0.03125, 0.0] * 3)
    edits = [('means', beyond)] + [(section, lambda seen: seen) for section in decoder.NAMES[1:]]
    return forged(name, *[((section, decoder.SHARED, i, 0), edit) for section, edit in edits for i in layers_of(name)], file=file)

# --- Command line
# ------------------------------------------------------------------------------------------------------

def table(files):
    rows = [{'file': f'{name}.tcgs', 'kind': kind, 'section': section, 'field': field, 'wrong': wrong} for name, kind, section, field, wrong, _ in files]
    return '{ "files": [\n' + ',\n'.join('  ' + json.dumps(row) for row in rows) + '\n] }\n'

def main(arguments, files, vectors, folder, vectors_folder):
    """The command line.

    - `files`: as `refused` gives them; `vectors`: functions, each named as the vector that it makes
    - `folder`, `vectors_folder`: where they go
    """
    made = {folder / f'{name}.tcgs': data for name, *_, data in files}
    made[folder / 'refused.json'] = table(files).encode()
    vectors = {vectors_folder / f'{make.__name__}.tcgs': make() for make in vectors}
    if arguments == ['--check']:
        for path, data in (made | vectors).items():
            if path.read_bytes() != data: sys.exit(f'{path}: is not what is made')
        for row in json.loads((folder / 'refused.json').read_text())['files']:
            path = folder / row['file']
            try: decoder.decode(path.read_bytes())
            except decoder.Refused as error:
                if (error.section, error.field) != (row['section'], row['field']): sys.exit(f'{path}: {error}, expected {row}')
            else: sys.exit(f'{path}: is not refused')
        print(f'{len(files)} files are refused, each for its reason')
    elif not arguments:
        for path, data in made.items(): path.write_bytes(data)
        for path, data in vectors.items():
            if not path.exists(): path.write_bytes(data)
    else: sys.exit(sys.modules['__main__'].__doc__)

if __name__ == '__main__':
    forged_vectors = optional_sections, symbols_beyond, dropped_bits
    main(sys.argv[1:], list(refused()), forged_vectors, FOLDER / 'refused', FOLDER / 'v1')
