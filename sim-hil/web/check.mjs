// Runs the page's script in Node: node check.mjs MODULE SECONDS
import { readFileSync } from "node:fs";
const { instance } = await WebAssembly.instantiate(readFileSync(process.argv[2]), {});
const { memory, flix_input, flix_output, flix_script } = instance.exports;
const seconds = Number(process.argv[3]);
flix_input(0);
const start = performance.now();
const length = flix_script(seconds * 1000);
const wall = (performance.now() - start) / 1000;
const text = new TextDecoder().decode(new Uint8Array(memory.buffer, flix_output(), Math.abs(length)));
if (length < 0) throw new Error(text);
console.log(JSON.stringify({ ...JSON.parse(text), real_time_factor: seconds / wall }));
