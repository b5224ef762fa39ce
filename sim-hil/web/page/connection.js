// ---- the robot in this page: a worker that looks like the WebSocket of a cockpit
const NO_CONNECTION = "The robot is starting.", STOP_UNHEARD = NO_CONNECTION;
// It is as slow as this computer is.
const SILENT_MS = Infinity, GIVE_UP_MS = Infinity, DEAF_MS = Infinity;
const packed = "{{module}}";
const workerSource = URL.createObjectURL(new Blob([{{worker}}], { type: "text/javascript" }));
const unpacked = new Response(new Blob([Uint8Array.from(atob(packed), (c) => c.charCodeAt(0))]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
const element = (id) => document.getElementById(id);
const CORE = 3, TOP_ROTOR = 4, AXIS = 0.004;
let robotWorker, world, parts = [], ended;
const tell = (wish) => robotWorker?.postMessage({ line: JSON.stringify(wish) });

function openConnection() {
  const worker = robotWorker = new Worker(workerSource);
  const connection = {
    readyState: WebSocket.CONNECTING,
    send: (line) => worker.postMessage({ line }),
    close: () => { worker.terminate(); connection.readyState = WebSocket.CLOSED; },
  };
  worker.onmessage = ({ data }) => {
    if (worker !== robotWorker) return;
    if (data.ended !== undefined) {
      ended = data.ended;
      element("world-says").textContent = `${ended}. Reset starts anew.`;
      return;
    }
    const said = JSON.parse(data.said);
    if (said.parts) {
      parts = said.parts.map((part) => ({ half_size: part.half_size, colour: part.colour }));
      // Of the core its axis alone, so that the rotors are seen.
      parts[CORE].half_size = [AXIS, AXIS, parts[CORE].half_size[2]];
      connection.readyState = WebSocket.OPEN;
      changeLink();
      listFaults(said.faults);
    }
    world = said.world;
    connection.onmessage({ data: data.said });
    if (world) showWorld();
  };
  const options = JSON.stringify({ model: element("model").value, seed: Number(element("seed").value) });
  unpacked.then((module) => worker.postMessage({ module, options }));
  return connection;
}
function reset() {
  robotWorker.terminate();
  world = ended = undefined;
  drawn = [];
  element("world-says").textContent = "";
  way.length = 0;
  element("fault").value = "";
  connection.onclose();
}

// ---- what a visitor does to the world
const changeLink = () => {
  const latency_ms = Number(element("latency").value), loss = Number(element("loss").value) / 100;
  element("latency-value").textContent = `${latency_ms} ms`;
  element("loss-value").textContent = `${element("loss").value} %`;
  tell({ link: { latency_ms, loss } });
};
function listFaults(names) {
  if (element("fault").options.length > 1) return;
  for (const name of names) element("fault").add(new Option(name, name));
}
element("latency").oninput = element("loss").oninput = changeLink;
element("fault").onchange = () => { tell("mend"); if (element("fault").value) tell({ fault: element("fault").value }); element("fault").blur(); };
element("model").onchange = element("seed").onchange = element("reset").onclick = () => {
  if (!element("seed").reportValidity()) return;
  document.activeElement.blur();
  reset();
};

// Fingers and mouse on the floor turn the camera, pull the robot, or draw.
const GRASP_WITHIN = 0.14, POINT_EVERY = 0.02, ROOM = 1.3;
let tool = "look", drawn = [], holding;
for (const button of document.querySelectorAll("[data-tool]")) {
  button.onclick = (event) => {
    if (event.detail) button.blur();
    tool = button.dataset.tool;
    if (tool === "draw") scene.camera.distance = Math.max(scene.camera.distance, ROOM);
    for (const other of document.querySelectorAll("[data-tool]")) other.setAttribute("aria-pressed", String(other === button));
    element("view").style.cursor = { look: "", push: "move", draw: "crosshair" }[tool];
  };
}
const far = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
const onFloor = (event) => { const box = element("view").getBoundingClientRect(); return scene.ground(event.clientX - box.left, event.clientY - box.top); };
function down(event) {
  if (tool === "look" || !world) return;
  const at = onFloor(event);
  if (!at || (tool === "push" && far(at, world.poses[0]) > GRASP_WITHIN)) return;
  event.stopImmediatePropagation();
  element("view").setPointerCapture(event.pointerId);
  holding = event.pointerId;
  if (tool === "draw") drawn = [at];
}
function move(event) {
  if (event.pointerId !== holding) return;
  event.stopImmediatePropagation();
  const at = onFloor(event);
  if (!at) return;
  if (tool === "push") tell({ pull: at });
  else if (far(at, drawn.at(-1)) > POINT_EVERY && drawn.length < 2000) drawn.push(at);
}
function up(event) {
  if (event.pointerId !== holding) return;
  event.stopImmediatePropagation();
  holding = undefined;
  if (tool === "push") tell({ pull: null });
  else if (drawn.length > 2) tell({ follow: drawn });
  drawn = [];
}
for (const [name, handler] of [["pointerdown", down], ["pointermove", move], ["pointerup", up], ["pointercancel", up]]) {
  element("view").addEventListener(name, handler, { capture: true });
}
function showWorld() {
  const error = world.error_rms;
  element("world-says").textContent = world.tracks ? `Follows the path${error ? `, ${(1000 * error).toFixed(0)} mm off on average` : ""}` : "";
}

// ---- drawing: the plant's own poses; the rotors as slowly as the cockpit shows them
const ownPicture = () => drawn;
function drawWorld(scene, snapshot) {
  const line = (points, style) => scene.polyline(points.map(([x, y]) => [x, y, 0.001]), style, 2, [7, 5]);
  const shown = snapshot?.world;
  if (!shown || shown.poses.length !== parts.length) return true;
  const amber = dark.matches ? "#e0b050" : "#a86a00";
  if (shown.path.length) line(shown.path, amber);
  if (drawn.length) line(drawn, amber);
  const poses = shown.poses.map(([x, y, z, ...turn]) => ({ position: [x, y, z], axes: rotation(turn) }));
  const body = poses[0];
  (snapshot.rotors ?? []).forEach((angle, index) => {
    const axes = aboutZ(-radians(angle)), arm = parts[TOP_ROTOR + index].half_size[0];
    const [, , height] = [0, 1, 2].map((i) => [0, 1, 2].reduce((sum, k) => sum + body.axes[k][i] * (poses[TOP_ROTOR + index].position[k] - body.position[k]), 0));
    poses[TOP_ROTOR + index] = { position: place(body, [arm * axes[0][0], arm * axes[1][0], height]), axes: product(body.axes, axes) };
  });
  scene.boxes(parts, poses);
  if (shown.pull) scene.arrow(body.position, [...shown.pull, body.position[2]], dark.matches ? [224, 176, 80] : [168, 106, 0]);
  return true;
}

// ---- the same bits: a script without drawing, in a worker of its own
async function runScript(script = "", seconds = 10) {
  const worker = new Worker(workerSource), module = await unpacked;
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => (data.verdict ? resolve(data.verdict) : reject(new Error(data.ended)));
    worker.postMessage({ module, script, seconds });
  });
}
globalThis.runScript = runScript;
async function check(script) {
  element("hash").textContent = "10 s of the robot's time …";
  try {
    const { hash, real_time_factor } = await runScript(script);
    element("hash").textContent = `${hash} (${real_time_factor.toFixed(1)} times real time)`;
  } catch (error) {
    element("hash").textContent = error.message;
  }
}
element("check").onclick = () => { element("check").blur(); check(); };
const asked = new URLSearchParams(location.search).get("script");
if (asked !== null) check(asked);
