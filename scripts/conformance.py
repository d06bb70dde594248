#!/usr/bin/env python3
"""Tests any decoder of .tcgs files on all vectors and all files that must be refused (docs/FORMAT.md, "Conformance").

  scripts/conformance.py --decoder "COMMAND {file} {out}"

runs COMMAND in a shell once a file, with {file} the file to decode and {out} where its floats go. Of a vector it must exit
with 0 and write, for every timestep, all means, quats, log_scales, logit_opacities and colors, as little-endian binary32;
they are compared bit for bit. Of a file that must be refused it must exit with another code below 126: a crash is no
refusal. Prints a table; exits with 1 if a file fails. Needs Python 3.9 or newer and nothing else.

Examples:
  scripts/conformance.py --decoder "python3 testdata/bitstream/decode.py {file} {out}"
  scripts/conformance.py --decoder "tcgs info {file} && tcgs export {file} --to {out}"
"""
import argparse, json, math, pathlib, shlex, struct, subprocess, sys, tempfile

FOLDER = pathlib.Path(__file__).resolve().parent.parent / 'testdata' / 'bitstream'
sys.path.insert(0, str(FOLDER))
sys.dont_write_bytecode = True
import decode as reference

def bits(value): return struct.unpack('<I', struct.pack('<f', value))[0]

def first_difference(found, scene, expected):
    """Where the floats of a decoder differ from those expected; None if nowhere."""
    components = reference.COMPONENTS
    per_timestep = 4 * sum(components) * scene.info['num_gaussians']
    want_bytes = per_timestep * scene.info['num_timesteps']
    if len(found) != want_bytes: return f'{len(found)} bytes of floats, expected {want_bytes}'
    # What a vector says of some timesteps; the decoder in Python says the others.
    known = {at['timestep']: [at['values'][name] for name in reference.NAMES] for at in expected['reconstructed']}
    for t in range(scene.info['num_timesteps']):
        at = t * per_timestep
        values = [[reference.f32(float(x)) for x in values] for values in known[t]] if t in known else scene.at(t)
        want = b''.join(struct.pack(f'<{len(v)}f', *v) for v in values)
        if found[at:at + per_timestep] == want: continue
        for name, count, values in zip(reference.NAMES, components, values):
            for i, value in enumerate(values):
                is_, = struct.unpack_from('<f', found, at)
                same = bits(is_) == bits(value) or math.isnan(is_) and math.isnan(value)
                if not same: return f'{name} of Gaussian {i // count}, component {i % count}, timestep {t}: {is_!r}, expected {value!r}'
                at += 4
    return None

class Runner:
    def __init__(self, command, seconds, folder):
        if '{file}' not in command or '{out}' not in command: sys.exit(f'--decoder {command!r}: expected {{file}} and {{out}} in it')
        self.command, self.seconds, self.folder = command, seconds, folder
    def run(self, file):
        """The exit code, or None after too long; the floats; the last line that was said."""
        out = self.folder / (file.stem + '.f32')
        command = self.command.replace('{file}', shlex.quote(str(file))).replace('{out}', shlex.quote(str(out)))
        try: done = subprocess.run(command, shell=True, capture_output=True, timeout=self.seconds)
        except subprocess.TimeoutExpired: return None, None, ''
        said = (done.stderr or done.stdout).decode('utf-8', 'replace').strip().splitlines()
        floats = out.read_bytes() if out.exists() else None
        out.unlink(missing_ok=True)
        return done.returncode, floats, said[-1] if said else ''

    def vector(self, file):
        """What is wrong; None if nothing is."""
        code, floats, said = self.run(file)
        if code is None: return f'not done after {self.seconds:g} s'
        if code != 0: return f'exit code {code}: {said}'
        if floats is None: return 'wrote no floats'
        expected = json.loads(file.with_suffix('.json').read_text())
        return first_difference(floats, reference.decode(file.read_bytes()), expected)

    def refused(self, file):
        code, _, said = self.run(file)
        if code is None: return f'not done after {self.seconds:g} s'
        if code == 0: return 'was decoded'
        return None if 0 < code < 126 else f'crashed: exit code {code}: {said}'

def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--decoder', required=True, metavar='COMMAND', help='with {file} and {out}')
    parser.add_argument('--seconds', type=float, default=60, help='that a file may take [default: 60]')
    parser.add_argument('--json', type=pathlib.Path, metavar='FILE', help='also write the result to this file')
    options = parser.parse_args()
    vectors = sorted((FOLDER / 'v1').glob('*.tcgs'))
    refused = json.loads((FOLDER / 'refused' / 'refused.json').read_text())['files']
    if not vectors or not refused: sys.exit(f'{FOLDER}: no vectors, expected the whole repository')
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        runner = Runner(options.decoder, options.seconds, pathlib.Path(folder))
        for file in vectors: rows.append(('decodes', file.name, runner.vector(file), ''))
        for row in refused: rows.append(('refuses', row['file'], runner.refused(FOLDER / 'refused' / row['file']), row['wrong']))
    for what, name, problem, wrong in rows:
        print(f'{"FAIL" if problem else "ok":<4}  {what}  {name:<30}  {problem or wrong}'.rstrip())
    failed = sum(problem is not None for *_, problem, _ in rows)
    print(f'{len(rows) - failed} of {len(rows)} files as they should be: {len(vectors)} to decode, {len(refused)} to refuse')
    if options.json:
        result = [{'file': name, 'test': what, 'problem': problem} for what, name, problem, _ in rows]
        options.json.write_text(json.dumps(result, indent=1) + '\n')
    sys.exit(failed > 0)

if __name__ == '__main__': main()
