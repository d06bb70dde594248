// Asks Dawn, with Chrome's shader compiler Tint, about a .wgsl file. Its null backend needs no GPU, grants what every
// browser grants, and has no optional features. One file a process: with more, Dawn has been seen to crash.
//
//   node validate.mjs FILE

import { readFileSync } from 'node:fs';
import { basename } from 'node:path';
import { create, globals } from 'webgpu';

Object.assign(globalThis, globals);

const path = process.argv[2];
let numErrors = 0;

function report(kind, place, message) {
  numErrors += kind === 'error';
  console.log(`${place}: ${kind}: ${message}`);
}

function entryPoints(code, stage) {
  const withoutComments = code.replace(/\/\/.*|\/\*[^]*?\*\//g, '');
  const functions = new RegExp(`@${stage}\\b[^{};]*\\bfn\\s+(\\w+)`, 'g');
  return [...withoutComments.matchAll(functions)].map(([, name]) => name);
}

async function validate(device) {
  const file = basename(path);
  const code = readFileSync(path, 'utf8');
  const before = numErrors;
  // Otherwise the error would be printed a second time.
  device.pushErrorScope('validation');
  const module = device.createShaderModule({ label: file, code });
  const { messages } = await module.getCompilationInfo();
  const scope = await device.popErrorScope();
  const lines = code.split('\n');
  for (const { type, lineNum, linePos, message } of messages) {
    report(type, `${path}:${lineNum}:${linePos}`, `${message}\n    ${lines[lineNum - 1]?.trim() ?? ''}`);
  }
  if (numErrors > before) {
    return;
  }
  if (scope !== null) {
    report('error', path, scope.message);
    return;
  }
  const entries = entryPoints(code, 'compute');
  const [vertex] = entryPoints(code, 'vertex');
  const [fragment] = entryPoints(code, 'fragment');
  const draws = vertex !== undefined && fragment !== undefined;
  if (entries.length === 0 && !draws) {
    report('error', path, 'no entry point');
  }
  // Some limits are those of a pipeline: storage buffers, threads, workgroup memory. Backward kernels and those of listed
  // parts never run in a browser, and may pass them.
  const trains = (entryPoint) => entryPoint.endsWith('_bwd') || file.endsWith('_listed.wgsl');
  const forward = entries.filter((entryPoint) => !trains(entryPoint));
  const pipelines = forward.map((entryPoint) => ({
    name: entryPoint,
    make: () => device.createComputePipeline({ layout: 'auto', compute: { module, entryPoint } }),
  }));
  if (draws) {
    pipelines.push({
      name: `${vertex} and ${fragment}`,
      make: () =>
        device.createRenderPipeline({
          layout: 'auto',
          vertex: { module, entryPoint: vertex },
          fragment: { module, entryPoint: fragment, targets: [{ format: 'bgra8unorm' }] },
        }),
    });
  }
  for (const { name, make } of pipelines) {
    device.pushErrorScope('validation');
    make();
    const error = await device.popErrorScope();
    if (error !== null) {
      report('error', `${path}, ${name}`, error.message);
    }
  }
  if (numErrors === before) {
    const count = entries.length + (draws ? 2 : 0);
    console.log(`${file}: ${count} entry points, ${pipelines.length} pipelines`);
  }
}

const adapter = await create(['backend=null']).requestAdapter();
const device = await adapter.requestDevice();
await validate(device);
device.destroy();
process.exitCode = numErrors > 0 ? 1 : 0;
