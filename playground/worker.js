// Runs the simulator beside the page, so that controls never wait for it.
'use strict';

let module; // compiled once
let instance;
const decoder = new TextDecoder();
const encoder = new TextEncoder();

// Profiles that were made of settings stay in memory, so now and then it begins with an empty one.
const MOST_BYTES = 256 * 1024 * 1024;

async function start() {
  if (!module) {
    const answer = await fetch('isocat_playground.wasm.gz');
    if (!answer.ok) throw new Error(`isocat_playground.wasm.gz: ${answer.status} ${answer.statusText}; expected it beside the page, see playground/build`);
    module = await WebAssembly.compile(await unpacked(await answer.arrayBuffer()));
  }
  instance = await WebAssembly.instantiate(module, {});
}

// Few static servers compress by themselves, so the file is compressed. One that says so to the browser has it unpacked already.
async function unpacked(bytes) {
  const [first, second] = new Uint8Array(bytes);
  if (first !== 0x1f || second !== 0x8b) return bytes;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Response(stream).arrayBuffer();
}

function ask(text) {
  const bytes = encoder.encode(text);
  const { memory, input, work, output } = instance.exports;
  const place = input(bytes.length);
  new Uint8Array(memory.buffer, place, bytes.length).set(bytes);
  const length = work();
  return decoder.decode(new Uint8Array(memory.buffer, output(), length));
}

onmessage = async ({ data: { number, text } }) => {
  try {
    if (!instance || instance.exports.memory.buffer.byteLength > MOST_BYTES) await start();
    const began = performance.now();
    const answer = ask(text);
    postMessage({ number, answer: JSON.parse(answer), took: performance.now() - began });
  } catch (error) {
    instance = undefined; // after a panic nothing in it can be trusted
    postMessage({ number, error: String(error.message || error) });
  }
};
