#!/usr/bin/env python3
"""Tests any decoder of .tcgs files on all vectors and all files that must be refused (docs/FORMAT.md, "Conformance").

  scripts/conformance.py --decoder "COMMAND {file} {out}"

runs COMMAND in a shell once a file, with {file} the file to decode and {out} where its floats go. Of a vector it must exit
with 0 and write, for every timestep, all means, quats, log_scales, logit_opacities, colors and further attributes of the
Gaussians that live at it, as little-endian binary32; they are compared bit for bit. Of a file that must be refused it must exit with another code below 126: a crash is no
refusal. Prints a table; exits with 1 if a file fails. Needs Python 3.9 or newer and nothing else.

Examples:
  scripts/conformance.py --decoder "python3 testdata/bitstream/decode.py {file} {out}"
  scripts/conformance.py --decoder "tcgs info {file} && tcgs export {file} --to {out}"
"""
import argparse, concurrent.futures, json, math, os, pathlib, shlex, struct, subprocess, sys, tempfile

FOLDER = pathlib.Path(__file__).resolve().parent.parent / 'testdata' / 'bitstream'
sys.path.insert(0, str(FOLDER))
sys.dont_write_bytecode = True
import decode as reference

def bits(value): return struct.unpack('<I', struct.pack('<f', value))[0]

def first_difference(found, scene, expected):
    """Where the floats of a decoder differ from those expected; None if nowhere."""
    names, components, at = scene.names(), scene.components(), 0
    # The floats of some timesteps from a vector; the decoder in Python gives the others.
    known = {at['timestep']: [at['values'][name] for name in names] for at in expected['reconstructed']}
    for t in range(scene.info['num_timesteps']):
        values = [[reference.f32(float(x)) for x in values] for values in known[t]] if t in known else scene.at(t)
        want = b''.join(struct.pack(f'<{len(v)}f', *v) for v in values)
        end = at + len(want)
        if len(found) < end: return f'{len(found)} bytes of floats, expected at least {end}, up to timestep {t}'
        if found[at:end] == want:
            at = end
            continue
        for name, count, values in zip(names, components, values):
            for i, value in enumerate(values):
                is_, = struct.unpack_from('<f', found, at)
                same = bits(is_) == bits(value) or math.isnan(is_) and math.isnan(value)
                if not same: return f'{name} of Gaussian {i // count}, component {i % count}, timestep {t}: {is_!r}, expected {value!r}'
                at += 4
    return f'{len(found)} bytes of floats, expected {at}' if len(found) > at else None

class Runner:
    def __init__(self, command, seconds, folder):
        if '{file}' not in command or '{out}' not in command: sys.exit(f'--decoder {command!r}: expected {{file}} and {{out}} in it')
        self.command, self.seconds, self.folder = command, seconds, folder
    def run(self, file):
        """The exit code, or None after too long; the floats; the last line that was said."""
        # A file to refuse may have the name of one to decode.
        out = self.folder / f'{file.parent.name}-{file.stem}.f32'
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

    def problem(self, what, file): return (self.vector if what == 'decodes' else self.refused)(file)

def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--decoder', required=True, metavar='COMMAND', help='with {file} and {out}')
    parser.add_argument('--version', type=int, choices=[1, 2], help='of the format [default: both]')
    parser.add_argument('--seconds', type=float, default=60, help='that a file may take [default: 60]')
    parser.add_argument('--jobs', type=int, default=os.cpu_count(), help='files at a time [default: one a processor]')
    parser.add_argument('--json', type=pathlib.Path, metavar='FILE', help='also write the result to this file')
    options = parser.parse_args()
    # Files of a version to decode, and to refuse.
    folders = {1: ('v1', 'refused'), 2: ('v2', 'refused_v2')}
    # The task of a decoder, the file, and the fault of the file.
    tasks = []
    for version in [options.version] if options.version else folders:
        vectors, refused = (FOLDER / name for name in folders[version])
        files = sorted(vectors.glob('*.tcgs'))
        table = json.loads((refused / 'refused.json').read_text())['files']
        if not files or not table: sys.exit(f'{FOLDER}: no vectors, expected the whole repository')
        tasks += [('decodes', file, '') for file in files]
        tasks += [('refuses', refused / row['file'], row['wrong']) for row in table]
    with tempfile.TemporaryDirectory() as folder, concurrent.futures.ProcessPoolExecutor(options.jobs) as pool:
        runner = Runner(options.decoder, options.seconds, pathlib.Path(folder))
        problems = list(pool.map(runner.problem, *zip(*[task[:2] for task in tasks])))
    rows = [(what, f'{file.parent.name}/{file.name}', problem, wrong) for (what, file, wrong), problem in zip(tasks, problems)]
    for what, name, problem, wrong in rows:
        print(f'{"FAIL" if problem else "ok":<4}  {what}  {name:<40}  {problem or wrong}'.rstrip())
    failed = sum(problem is not None for *_, problem, _ in rows)
    decoded = sum(what == 'decodes' for what, *_ in rows)
    print(f'{len(rows) - failed} of {len(rows)} files as they should be: {decoded} to decode, {len(rows) - decoded} to refuse')
    if options.json:
        result = [{'file': name, 'test': what, 'problem': problem} for what, name, problem, _ in rows]
        options.json.write_text(json.dumps(result, indent=1) + '\n')
    sys.exit(failed > 0)

if __name__ == '__main__': main()
