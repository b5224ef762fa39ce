// The robot, its plant and its operator's client, in real time. Lines of the page go in; snapshots come out.
let robot, memory;
const text = new TextEncoder(), words = new TextDecoder();
// Returns what a call of the module answers; throws its complaint.
function call(name, line = "", ...numbers) {
  const bytes = text.encode(line);
  // Asking for room may move the memory.
  const room = robot.flix_input(bytes.length);
  new Uint8Array(memory.buffer).set(bytes, room);
  const length = robot[name](...numbers);
  const answer = words.decode(new Uint8Array(memory.buffer, robot.flix_output(), Math.abs(length)));
  if (length < 0) throw new Error(answer);
  return answer;
}
const FRAME_MS = 33, TURN_MS = 8, LARGEST_LAG_MS = 50;
// The world waits for a page that is slow or hidden: its time is at most so far ahead of what the page has shown.
const LEAD_MS = 70;
let last, shown = 0, debt = 0, time = 0, seen = 0;
function turn() {
  const now = performance.now();
  // A computer that is too slow for real time shows slow motion.
  debt = Math.min(LARGEST_LAG_MS, debt + now - last);
  last = now;
  const whole = Math.max(0, Math.min(Math.floor(debt), seen + LEAD_MS - time));
  debt -= whole;
  time += whole;
  try {
    call("flix_advance", "", whole);
    if (now - shown >= FRAME_MS) {
      shown = now;
      postMessage({ said: call("flix_snapshot") });
    }
  } catch (error) {
    postMessage({ ended: error.message });
    return close();
  }
  setTimeout(turn, Math.max(0, TURN_MS - (performance.now() - now)));
}
onmessage = async ({ data }) => {
  try {
    if (data.module) {
      ({ instance: { exports: robot } } = await WebAssembly.instantiate(data.module, {}));
      memory = robot.memory;
      if (data.script !== undefined) {
        const start = performance.now();
        const verdict = JSON.parse(call("flix_script", data.script, 1000 * data.seconds));
        postMessage({ verdict: { ...verdict, real_time_factor: data.seconds / ((performance.now() - start) / 1000) } });
        return close();
      }
      postMessage({ said: call("flix_start", data.options) });
      last = performance.now();
      return turn();
    }
    seen = Math.max(seen, JSON.parse(data.line).seen ?? 0);
    call("flix_say", data.line);
  } catch (error) {
    postMessage({ ended: error.message });
    close();
  }
};
