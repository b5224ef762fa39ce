const byId = (id) => document.getElementById(id);
const modes = JSON.parse(byId("mode-table").textContent);
// An input that waited longer, in a page that hung, is not what its operator wants now. What calms is always sent.
const OLD_INPUT_MS = 250, CALMING = ["stop", "rest", "disarm"];
// The clock of inputs may be another one than that of the page, or stand at 0. An input of unknown age counts while the page is seen,
// and draws: one that was queued while a phone slept comes before its page has drawn.
const DRAWN_MS = 300, STEADY_MS = 1000, SLEPT_MS = 1000;
let drawnAt = -Infinity, steadySince = -Infinity;
const isDrawn = () => document.visibilityState === "visible" && performance.now() - drawnAt < DRAWN_MS;
// By how much the clock of inputs is behind that of the page, which alone goes on while some phones sleep: after a sleep the least age
// of an input that came while the page draws steadily.
let lag = 0;
function ageOf(event) {
  const now = performance.now(), age = now - event.timeStamp;
  if (!(event.timeStamp > 0 && age >= 0)) return undefined;
  if (lag !== 0 && isDrawn() && now - steadySince > STEADY_MS) lag = Math.min(lag, age);
  return lag === Infinity ? age : age - lag;
}
for (const kind of ["pointerdown", "pointermove", "keydown", "keyup"]) addEventListener(kind, ageOf, { capture: true, passive: true });
function noteFrame() {
  const now = performance.now(), gap = now - drawnAt;
  if (gap > DRAWN_MS) steadySince = now;
  if (gap > SLEPT_MS && gap < Infinity) lag = Infinity;
  drawnAt = now;
}
// What the robot commands to rest by itself is noticed in this time.
const SETTLED_MS = 400;

// What fails is said, and ends nothing but itself: the page goes on to show the robot, and stops it.
let failed;
function attempt(what, run) {
  try {
    run();
    if (failed === what) failed = undefined;
  } catch (error) {
    if (failed !== what) console.error(what, error);
    failed = what;
  }
}
const last = (list) => list[list.length - 1];

// ---- the connection: every snapshot is answered with the stamp of the newest one that was drawn
// A connection may stand and bring nothing: what was shown last is not how the robot is now, and another one is opened.
let me, snapshot, shown = 0, connection, arrivedAt, watchedAt = 0;
// The newest press of STOP, since when nobody has said to have heard one, since when it is sent by this connection, and how long
// that may take until another one is tried. Where there is none every comparison with its time is false.
let press, unheardSince, sentSince, deafMs = DEAF_MS;
const STOP_ANSWER_MS = 500;
// How much later than the fastest of this connection a picture has come. Clocks part by less than DRIFT of their time.
const DRIFT = 0.0005;
let least, late = 0;
function measure(stamp, now) {
  const behind = now - stamp;
  least = least === undefined ? behind : Math.min(behind, least + DRIFT * (now - arrivedAt));
  late = behind - least;
}
function send(request) {
  if (request === "stop") {
    press = Math.floor(Math.random() * 2 ** 32);
    unheardSince ??= performance.now();
    return sendStop();
  }
  if (connection?.readyState === WebSocket.OPEN) connection.send(message(request));
}
function sendStop() {
  if (connection?.readyState !== WebSocket.OPEN) return;
  connection.send(message("stop", press));
  sentSince ??= performance.now();
}
const message = (request, press) => JSON.stringify({ seen: shown, do: request, press });
// A longer one is none of a page.
const isTooLong = (request) => new TextEncoder().encode(message(request)).length > LONGEST;
function connect() {
  const own = connection = openConnection();
  arrivedAt = performance.now();
  sentSince = undefined;
  least = undefined;
  own.onmessage = (event) => {
    const data = JSON.parse(event.data);
    if ("you" in data) { me = data.you; if (unheardSince !== undefined) sendStop(); if (byId("settings").open) send("settings"); return; }
    if (data.settings) showSettings(data.settings);
    if (data.scope) showScope(data.scope);
    if (!("stamp" in data)) return;
    snapshot = data;
    const now = performance.now();
    measure(data.stamp, now);
    arrivedAt = now;
    if (data.presses.includes(press)) [unheardSince, sentSince, deafMs] = [undefined, undefined, DEAF_MS];
    send();
  };
  own.onclose = () => {
    if (own !== connection) return;
    connection = me = undefined;
    shown = 0;
    showNothing();
    setTimeout(connect, unheardSince === undefined ? 1000 : 100);
  };
}
function showNothing() { snapshot = undefined; forgetHands(); letGo(); }
function watchConnection() {
  const now = performance.now(), silent = now - arrivedAt, hasStood = now - watchedAt > SILENT_MS;
  watchedAt = now;
  // What came while the page stood still is taken first.
  if (hasStood) return;
  if (snapshot && silent > SILENT_MS) showNothing();
  const isDeaf = now - sentSince > deafMs;
  if (!connection || (silent <= GIVE_UP_MS && !isDeaf)) return;
  if (isDeaf) deafMs *= 2;
  const old = connection;
  old.onclose();
  old.close();
}
// What is said for a while beside the robot's own log.
const REMARKED_MS = 10000;
let remark;
function say(text) { remark = { text, at: performance.now() }; }
const drives = () => snapshot !== undefined && snapshot.driver === me;
const isWanted = () => snapshot !== undefined && snapshot.wanted[0] !== 0;
function act(request, event) {
  if (event && !CALMING.includes(request)) {
    const age = ageOf(event);
    if (age === undefined && !isDrawn()) return say("an input came while the page stood still and was passed over");
    if (age > OLD_INPUT_MS) return say(`an input came ${(age / 1000).toFixed(1)} s late and was passed over`);
  }
  send(request);
}

// ---- a sign of the operator who says nothing else: a robot that walks rests without any
const ATTEND_MS = 250, COUNTED_S = 15;
let attendedAt;
function attend() {
  const now = performance.now();
  if (!drives() || now - attendedAt < ATTEND_MS) return;
  attendedAt = now;
  send("attend");
}
for (const kind of ["pointerdown", "pointermove", "wheel"]) addEventListener(kind, attend, { passive: true });
// Something may lie on a key: one that repeats counts where it is that of a walk.
addEventListener("keydown", (event) => { if (!event.repeat || keyed(event)?.walk) attend(); });

// ---- a walk that is held: it ends when what began it, a key or a pointer, is released
// A key may be released without a word, as from a keyboard whose radio is lost: it has to repeat, or another one that is pressed
// meanwhile, in whose place it repeats no more.
const REPEATS_WITHIN_MS = 800, SLOWEST_REPEATS_MS = 2500;
let heldBy, heardAt, repeats, patience;
function hear(isRepeat) {
  const now = performance.now();
  if (!isRepeat) patience = SLOWEST_REPEATS_MS;
  else if (repeats) patience = Math.min(Math.max(repeats > 1 ? patience : REPEATS_WITHIN_MS, 2 * (now - heardAt)), SLOWEST_REPEATS_MS);
  repeats = isRepeat ? repeats + 1 : 0;
  heardAt = now;
}
function hold(by) { heldBy = HOLDS ? by : undefined; hear(false); }
function letGo(by) {
  if (heldBy === undefined || (by !== undefined && by !== heldBy)) return;
  heldBy = undefined;
  send("rest");
}
function watchHeld() {
  if (heldBy !== undefined) attend();
  if (typeof heldBy === "string" && performance.now() - heardAt > patience) letGo();
}
addEventListener("keyup", (event) => { hear(false); letGo(event.code); });
addEventListener("keydown", (event) => {
  // While this key is down a Mac does not say that another is released.
  if (event.metaKey || event.key === "Meta") letGo();
  hear(event.repeat && event.code === heldBy);
});
for (const kind of ["pointerup", "pointercancel"]) addEventListener(kind, (event) => letGo(event.pointerId));
// The last button of a mouse to be released is another one.
addEventListener("pointermove", (event) => { if (!(event.buttons & 1)) letGo(event.pointerId); });
for (const kind of ["blur", "pagehide"]) addEventListener(kind, () => letGo());
// A menu takes the keys; another finger that stays opens one, too.
addEventListener("contextmenu", (event) => { if (!event.defaultPrevented) letGo(typeof heldBy === "string" ? heldBy : event.pointerId ?? -1); });

// ---- the screen of a phone stays on while the robot walks, where a page may ask for that: one that is not encrypted may not
let awake;
function keepAwake() {
  const isAwake = drives() && isWanted();
  if (isAwake && !awake) awake = navigator.wakeLock?.request("screen").catch(() => undefined);
  if (isAwake || !awake) return;
  awake.then((lock) => lock?.release());
  awake = undefined;
}

// ---- keyboard
const KEYS = {
  Enter: "arm", Backspace: "disarm", Delete: "disarm", Escape: "disarm", c: "clear", h: "hold_heading", s: "rest", 0: "rest",
};
const LETTERS = ["w", "a", "d", "q", "e"];
modes.forEach((mode, index) => { KEYS[LETTERS[index]] = KEYS[index + 1] = { walk: mode.name }; });
function keyed(event) {
  const fine = event.shiftKey;
  const steps = { ArrowUp: ["frequency", 1, 0.1], ArrowDown: ["frequency", -1, -0.1], ArrowRight: ["direction", 5, 1], ArrowLeft: ["direction", -5, -1] };
  const step = steps[event.key];
  if (step) return { [step[0]]: step[fine ? 2 : 1] };
  // On a keyboard without Latin letters a key is known by its place.
  const isOther = /^[\p{L}\p{M}\p{Nd}]$/u.test(event.key) && !/^[0-9\p{Script=Latin}]$/u.test(event.key), placed = isOther && /^(?:Key|Digit)(.)$/.exec(event.code);
  // An input method sends letters and digits of full width.
  const key = /^[\uff01-\uff5e]$/.test(event.key) ? event.key.normalize("NFKC") : event.key;
  return KEYS[placed ? placed[1].toLowerCase() : key.length === 1 ? key.toLowerCase() : key];
}
// What the space bar sends: white space and characters without a width, such as U+3000 by an input method and U+00A0 with Option; after
// a dead key the accent alone.
const BLANK = /^[\p{White_Space}\p{Cf}\u034f\u3164]$/u, ACCENT = /^[\^`~'"\u00a8\u00af\u00b0\u00b4\u00b8\u02c6\u02c7\u02d8-\u02dd\u0300-\u036f\u0384\u0385\u309b\u309c]$/;
addEventListener("keydown", (event) => {
  const isAccent = ACCENT.test(event.key) && !(event.ctrlKey || event.metaKey || event.target.matches("input, select"));
  if (event.code === "Space" || BLANK.test(event.key) || isAccent) {
    event.preventDefault();
    return act("stop");
  }
  const isCommand = !(event.ctrlKey || event.altKey || event.metaKey || event.isComposing || event.getModifierState?.("AltGraph"));
  if (!isCommand || event.target.matches("input, select")) return;
  // Enter presses the button that the keyboard has reached.
  if (event.key === "Enter" && document.activeElement.matches("button, summary")) return;
  const request = keyed(event);
  if (request === undefined) {
    // Whoever misses a key of a robot that walks may have meant any other.
    if ([...event.key].length === 1 && drives() && isWanted()) act("rest");
    return;
  }
  event.preventDefault();
  // Whoever holds a key wants what he wanted when he pressed it.
  if (event.repeat) return;
  act(request, event);
  if (request.walk) hold(event.code);
});
// The keyboard of a telephone names no key: a field gets its text alone.
addEventListener("beforeinput", (event) => {
  if (event.inputType === "insertFromPaste" || ![...(event.data ?? "")].some((letter) => BLANK.test(letter))) return;
  event.preventDefault();
  act("stop");
});
// The space bar stops, and presses no button besides.
addEventListener("keyup", (event) => { if (event.code === "Space") event.preventDefault(); });

// ---- buttons, by mouse and touch
const places = { forward: "w", "left turn": "a", "right turn": "d", "strafe left": "q", "strafe right": "e" };
for (const { name, request, key } of [...modes.map((mode) => ({ name: mode.name, request: { walk: mode.name }, key: places[mode.name] })), { name: "rest", request: "rest", key: "s" }]) {
  const button = document.createElement("button");
  button.dataset.do = JSON.stringify(request);
  button.dataset.mode = name;
  button.style.gridArea = key;
  button.setAttribute("aria-keyshortcuts", key);
  button.setAttribute("aria-pressed", "false");
  const hint = document.createElement("kbd");
  hint.textContent = key;
  button.append(name[0].toUpperCase() + name.slice(1), " ", hint);
  byId("modes").append(button);
}
for (const button of document.querySelectorAll("button[data-do]")) {
  const text = button.dataset.do;
  const request = /^[{"]/.test(text) ? JSON.parse(text) : text;
  // What is held begins when the pointer comes down; by Enter nothing can be held.
  const isHeld = HOLDS && request.walk;
  if (isHeld) {
    button.onpointerdown = (event) => { if (event.button === 0) { act(request, event); hold(event.pointerId); } };
    // A finger that stays opens no menu, and one that moves does not scroll.
    button.oncontextmenu = (event) => event.preventDefault();
    button.style.touchAction = "none";
  }
  button.onclick = (event) => {
    // A button that the pointer has pressed does not wait for Enter.
    if (event.detail) button.blur();
    if (!isHeld) act(request, event);
  };
}
byId("drive").onclick = (event) => { byId("drive").blur(); act("drive", event); };
// At once, when the finger comes down.
byId("stop").onpointerdown = () => act("stop");
byId("stop").onclick = (event) => { if (event.detail) byId("stop").blur(); else act("stop"); };
// A pinch, a field that is zoomed in, or a keyboard over the page leaves a part of it on the screen: STOP stays in that part, as
// large as before, but covers no more than a third of it.
const STOP_SHARE = 0.34;
function keepStop() {
  const { offsetLeft, offsetTop, width, height } = visualViewport, stop = byId("stop"), { offsetWidth, offsetHeight } = stop;
  const across = width / offsetWidth, up = Math.min(across, STOP_SHARE * height / offsetHeight);
  const right = offsetLeft - stop.offsetLeft + scrollX, down = offsetTop + height - up * offsetHeight - stop.offsetTop + scrollY;
  const isAlmost = (a, b) => Math.abs(a - b) < 1;
  const isWhole = isAlmost(right, 0) && isAlmost(width, offsetWidth) && isAlmost(offsetTop + height, stop.offsetTop + offsetHeight - scrollY);
  stop.style.transform = isWhole ? "" : `translate(${right}px, ${down}px) scale(${across}, ${up})`;
}
// A browser that has none zooms no part of a page.
if (window.visualViewport) for (const kind of ["resize", "scroll"]) visualViewport.addEventListener(kind, keepStop);

// ---- settings: read when they are opened, each changed by itself
const settings = byId("settings"), settingInputs = new Map();
settings.querySelector("summary").onclick = (event) => { if (event.detail) event.currentTarget.blur(); };
let settingsAskedAt = 0;
const ASK_AGAIN_MS = 1000;
function askForSettings() { settingsAskedAt = performance.now(); send("settings"); }
settings.ontoggle = () => { if (settings.open) askForSettings(); };
// The robot counts in single precision.
const short = (value) => Number(value.toPrecision(7));
// What was typed is judged where the command line judges it: a field for numbers alone drops a decimal comma without a word. A
// telephone's keys for numbers have no minus, and no point where its owner writes a comma.
const HAS_POINT = (1.5).toLocaleString().includes(".");
function settingRow({ name, unit, minimum, maximum, default: usual, description }) {
  const row = document.createElement("div"), label = document.createElement("label"), input = document.createElement("input"), help = document.createElement("small"), mark = document.createElement("em"), refused = document.createElement("em");
  row.className = "setting";
  label.textContent = name;
  label.htmlFor = input.id = `setting-${name}`;
  Object.assign(input, { type: "text", inputMode: minimum >= 0 && HAS_POINT ? "decimal" : "text", autocomplete: "off", spellcheck: false });
  Object.assign(refused, { className: "refused", id: `refused-${name}` });
  refused.setAttribute("role", "alert");
  input.setAttribute("aria-describedby", refused.id);
  const restore = () => { delete input.dataset.edited; input.value = input.dataset.robot; };
  // What the robot has is shown until it states another value.
  const commit = (event) => {
    const request = { set: [name, input.value] };
    restore();
    if (isTooLong(request)) write(refused.id, "This is longer than any number.");
    else act(request, event);
  };
  input.onkeydown = (event) => {
    // The same text again is no change to a browser.
    if (event.key === "Enter" && "edited" in input.dataset) commit(event);
    if (event.key === "Escape") restore();
  };
  input.oninput = () => { input.dataset.edited = ""; };
  input.onchange = commit;
  input.onblur = restore;
  help.textContent = `${short(minimum)} to ${short(maximum)}, at first ${short(usual)}. ${description ?? ""}`;
  row.append(label, input, Object.assign(document.createElement("span"), { textContent: unit === "1" ? "" : unit }), mark, refused, help);
  byId("settings-list").append(row);
  settingInputs.set(name, input);
  return input;
}
function showSettings(list) {
  for (const one of list) {
    const input = settingInputs.get(one.name) ?? settingRow(one);
    input.dataset.robot = short(one.value);
    if (!("edited" in input.dataset)) input.value = input.dataset.robot;
    input.parentElement.classList.toggle("changed", one.value !== one.default);
    // On what is assumed a robot does not arm.
    const mark = input.parentElement.querySelector("em");
    write(`refused-${one.name}`, one.refused ?? "");
    input.setAttribute("aria-invalid", String(Boolean(one.refused)));
    mark.textContent = one.mark ?? "";
    mark.className = one.mark === "assumed" ? "assumed" : "";
  }
}
byId("settings-find").oninput = ({ target }) => {
  // The space bar stops: words are found without it.
  const plain = (text) => text.toLowerCase().replace(/[\s_-]/g, ""), wanted = plain(target.value);
  for (const input of settingInputs.values()) input.parentElement.hidden = !plain(input.parentElement.textContent).includes(wanted);
};

// ---- scope: one chart for each unit
const SCOPE_COLOURS = ["#1e72ff", "#e66a00", "#278c6d", "#6b45bb", "#d1193a", "#01a0cc", "#99965c", "#c8589f"];
byId("scope").querySelector("summary").onclick = (event) => { if (event.detail) event.currentTarget.blur(); };
for (const [id, when] of [["scope-now", "now"], ["scope-fault", "fault"], ["scope-last", "last"]]) {
  byId(id).onclick = (event) => {
    if (event.detail) byId(id).blur();
    const channels = byId("scope-channels"), request = { scope: [channels.value, when] };
    channels.setCustomValidity(isTooLong(request) ? "This is longer than the names of eight channels." : "");
    if (channels.reportValidity()) act(request, event);
  };
}
byId("scope-channels").oninput = ({ target }) => target.setCustomValidity("");
function showScope({ begin_ms, step_ms, channels }) {
  const units = [...new Set(channels.map(({ unit }) => unit))];
  byId("scope-charts").replaceChildren(...units.map((unit) => {
    const drawn = channels.filter((channel) => channel.unit === unit), values = drawn.flatMap((channel) => channel.values);
    const low = values.reduce((a, b) => Math.min(a, b), Infinity), high = values.reduce((a, b) => Math.max(a, b), -Infinity);
    const figureElement = document.createElement("figure"), caption = document.createElement("figcaption"), canvas = document.createElement("canvas");
    const pen = canvas.getContext("2d"), width = canvas.width = 1400, height = canvas.height = 480, last = drawn[0].values.length - 1;
    const x = (row) => width * row / Math.max(last, 1), y = (value) => height * (0.95 - 0.9 * (value - low) / (high - low || 1));
    const trigger = -begin_ms / step_ms;
    if (trigger > 0) { pen.fillStyle = "#8a939f30"; pen.fillRect(x(trigger), 0, width, height); }
    caption.append(`${figure(low, 2)} to ${figure(high, 2)} ${unit}, ${figure(begin_ms, 0)} to ${figure(begin_ms + step_ms * last, 0)} ms: `);
    drawn.forEach((channel, index) => {
      const colour = SCOPE_COLOURS[index % SCOPE_COLOURS.length], name = document.createElement("b");
      pen.beginPath();
      channel.values.forEach((value, row) => (row ? pen.lineTo(x(row), y(value)) : pen.moveTo(x(row), y(value))));
      pen.strokeStyle = name.style.borderColor = colour; pen.lineWidth = 3; pen.stroke();
      name.textContent = `${channel.name} `;
      caption.append(name);
    });
    figureElement.append(caption, canvas);
    return figureElement;
  }));
}

// ---- gamepads: the one drives whose command changed last, and any ends the walk: it stops, disarms, or lets go of its
// stick. Each is obeyed after it was seen neutral, and again after everything that lets the robot rest; it stops and disarms always
const hands = new Map();
function handOn({ index }) {
  if (!hands.has(index)) hands.set(index, { down: [], neutral: false, mode: undefined, since: 0, shown: "", changed: 0 });
  return hands.get(index);
}
function forgetHands() { for (const hand of hands.values()) Object.assign(hand, { mode: undefined, neutral: false }); }
const BUTTONS = { 1: "stop", 3: "clear", 8: "disarm", 9: "arm" }, LOWER = 0;
// B is the right button on Xbox, and the lower one on Nintendo: a robot that walks is stopped by either.
const commandOf = (index) => (index === LOWER && (isWanted() || snapshot?.telemetry?.state === "running") ? "stop" : BUTTONS[index]);
// A stick that commands goes on to until it is well below where it began.
const DEAD_ZONE = 0.25, DEFLECTED = 0.6, KEPT = 0.4, LEAD = 0.1, UNTOUCHED_MS = 30000;
// A browser may have none, or give none to a page that is not encrypted. One that cannot be read is none: what it drives
// rests, and the others go on.
const orNone = (read) => { try { return read(); } catch { return []; } };
const seen = ({ index, id, mapping, axes, buttons }) => ({ index, id, mapping, axes: [...axes].map((axis) => axis || 0), buttons: [...buttons].map(({ pressed }) => ({ pressed })) });
const gamepads = () => orNone(() => [...(navigator.getGamepads?.() ?? [])]).flatMap((one) => orNone(() => (one?.connected ? [seen(one)] : []))).filter((one) => isKnown(one) || one.axes.length > 1);
// Where the layout is not known, nobody knows which button stops: every one does. Firefox states the standard layout of some gamepads
// that have more axes, and other buttons. A keyboard or a tablet that is listed has no stick, and is none.
const isKnown = (gamepad) => gamepad.mapping === "standard" && gamepad.axes.length <= 4;
function newlyPressed(gamepad, hand) {
  const down = gamepad.buttons.flatMap((button, index) => (button.pressed ? [index] : []));
  // Many a browser shows a gamepad only once a button is pressed.
  const before = hand.down;
  hand.down = down;
  return down.filter((index) => !before.includes(index));
}
function wantedBy(gamepad, before) {
  const [x = 0, y = 0] = gamepad.axes, from = (mode) => (mode === before ? KEPT : DEFLECTED);
  // The axis that leads goes on to until the other leads by so much.
  const lead = { forward: LEAD, "left turn": -LEAD, "right turn": -LEAD }[before] ?? 0;
  const isAhead = -y + lead >= Math.abs(x), isSideways = Math.abs(x) > Math.abs(y) + lead;
  const down = (index) => gamepad.buttons[index]?.pressed;
  if (down(4)) return "strafe left";
  if (down(5)) return "strafe right";
  if (down(12) || (-y > from("forward") && isAhead)) return "forward";
  if (down(14) || (-x > from("left turn") && isSideways)) return "left turn";
  if (down(15) || (x > from("right turn") && isSideways)) return "right turn";
  return undefined;
}
const isNeutral = (gamepad) => gamepad.axes.slice(0, 2).every((axis) => Math.abs(axis) < DEAD_ZONE) && !gamepad.buttons.some((button) => button.pressed);
function release(hand) {
  if (hand.mode !== undefined) send("rest");
  Object.assign(hand, { mode: undefined, neutral: false });
}
function readGamepad(gamepad, now) {
  const hand = handOn(gamepad), pressed = newlyPressed(gamepad, hand);
  // What is pressed is meant for what the operator looks at.
  const isWatched = document.hasFocus();
  if (!isKnown(gamepad)) {
    if (pressed.length) { send("stop"); say(`a button of ${gamepad.id || "a gamepad"} stops`); }
    release(hand);
    return "of a layout that is not known: its buttons stop";
  }
  if (!isWatched) release(hand);
  for (const command of pressed.map(commandOf)) {
    if (command && (hand.neutral || command === "stop" || command === "disarm")) send(command);
  }
  if (!isWatched) return "without the focus: it stops, and disarms";
  const state = snapshot?.telemetry?.state;
  const isDriven = drives() && (state === "armed" || state === "running");
  if (!isDriven) hand.mode = undefined;
  // The robot rests although the stick commands: something let it rest.
  if (hand.mode !== undefined && now - hand.since > SETTLED_MS && !isWanted()) release(hand);
  // One whose radio is lost may show for ever what it showed last.
  const shown = JSON.stringify([gamepad.axes, gamepad.buttons]);
  if (shown !== hand.shown) {
    if (hand.mode !== undefined) attend();
    Object.assign(hand, { shown, changed: now });
  }
  if (hand.mode !== undefined && now - hand.changed > UNTOUCHED_MS) release(hand);
  if (isNeutral(gamepad)) hand.neutral = true;
  if (!hand.neutral) return "let go of stick and buttons first";
  const mode = wantedBy(gamepad, hand.mode);
  if (mode !== hand.mode) {
    if (mode !== undefined && !isDriven) {
      hand.neutral = false;
    } else {
      send(mode === undefined ? "rest" : { walk: mode });
      Object.assign(hand, { mode, since: now });
    }
  }
  return mode ?? "neutral";
}
function readGamepads(now) {
  const connected = gamepads();
  for (const [index, hand] of hands) {
    if (connected.some((one) => one.index === index)) continue;
    release(hand);
    hands.delete(index);
  }
  const shown = connected.map((one) => readGamepad(one, now));
  const driver = [...hands.values()].filter(({ mode }) => mode !== undefined).sort((a, b) => b.since - a.since)[0];
  return driver?.mode ?? (shown.includes("neutral") ? "neutral" : shown[0] ?? "none");
}

// ---- an operator who looks elsewhere
function neutral() {
  if (drives() && isWanted()) send("rest");
  forgetHands();
}
addEventListener("blur", neutral);
addEventListener("pagehide", neutral);
// On a phone a keyboard comes up, and who types does not watch.
addEventListener("focusin", ({ target }) => { if (target.matches("input")) neutral(); });
document.addEventListener("visibilitychange", () => { if (document.visibilityState !== "visible") neutral(); });

// ---- the robot as boxes, at rest on its legs: half size and place in the body's frame, turn, colour. Legs as the
// paper's robot stands, which no robot reports; of the core its axis alone, so that the rotors are seen.
const PARTS = [
  [[0.11, 0.06, 0.00175], [0, 0, 0], [1, 0, 0, 0], [70, 76, 88]],
  [[0.0225, 0.015, 0.009], [0.08, 0, 0.0021], [1, 0, 0, 0], [60, 130, 90]],
  [[0.0225, 0.015, 0.009], [-0.08, 0, 0.0021], [1, 0, 0, 0], [44, 96, 150]],
  [[0.005, 0.005, 0.022], [0, 0, 0.0238], [1, 0, 0, 0], [120, 126, 138]],
];
const BEAM = [0.01, 0.008333, 0.0015], BEAM_COLOUR = [222, 222, 214], FOOT = [0.0425, 0.0025, 0.00475], FOOT_COLOUR = [40, 110, 170];
const TURNS = [[0.57, -0.57, 0.419, -0.419], [0.687, -0.687, 0.168, -0.168], [0.699, -0.699, -0.107, 0.107]];
for (const [front, shift] of [[1, -0.0027], [-1, 0.0084]]) {
  for (const left of [1, -1]) {
    TURNS.forEach(([w, x, y, z], index) => {
      PARTS.push([BEAM, [front * 0.1071, left * 0.049, -0.0101 - 0.0167 * index], [w, x, left * y, left * z], BEAM_COLOUR]);
    });
    PARTS.push([FOOT, [front * 0.107, left * (0.049 + shift), -0.0565], [0.707, 0, 0, 0.707], FOOT_COLOUR]);
  }
}
const ROTORS = [[0.0328, [214, 128, 30]], [0.0048, [170, 88, 20]]];
const ROTOR = [0.014, 0.0045, 0.003], STANDING = 0.0612, SHAKER = 0.0188;
const boxes = PARTS.map(([half_size, , , rgb]) => ({ half_size, colour: rgb }))
  .concat(ROTORS.map(([, rgb]) => ({ half_size: ROTOR, colour: rgb })));
const product = (a, b) => a.map((row) => [0, 1, 2].map((k) => row[0] * b[0][k] + row[1] * b[1][k] + row[2] * b[2][k]));
const aboutZ = (angle) => [[Math.cos(angle), -Math.sin(angle), 0], [Math.sin(angle), Math.cos(angle), 0], [0, 0, 1]];
const radians = (degrees) => degrees * Math.PI / 180;

let dark, scene;
function openScene() {
  const view = byId("view");
  dark = matchMedia("(prefers-color-scheme: dark)");
  scene = createScene(view, {
    size: () => [view.clientWidth, view.clientHeight],
    look: () => (dark.matches ? { grid: ["#232a34", "#3d4754"], edge: "#ffffff30" } : { grid: ["#dde1e7", "#aab3c0"], edge: "#00000026" }),
  });
  scene.camera.distance = 0.62;
  scene.camera.azimuth = -2.2;
}
const way = [];
// What the picture shows, to 0.1 mm; angles stay as they are drawn until they are half a degree off.
let pictured, steady = [];
function picture() {
  const { floor, world, rotors, wanted, telemetry } = snapshot ?? {}, view = byId("view");
  const angles = [...(rotors ?? []), telemetry && turns(telemetry.frequency) ? telemetry.direction : 0];
  steady = angles.map((angle, index) => (Math.abs(angle - steady[index]) < 0.5 ? steady[index] : angle));
  const all = [floor, world, steady, wanted, ownPicture(), scene.camera, view.clientWidth, view.clientHeight, devicePixelRatio, dark.matches];
  return JSON.stringify(all, (_, value) => (typeof value === "number" ? Math.round(1e4 * value) : value));
}
function drawRobot(body, at) {
  const poses = PARTS.map(([, p, turn]) => ({ position: at(p), axes: product(body.axes, rotation(turn)) }));
  const rotors = snapshot?.rotors ?? [0, 0];
  ROTORS.forEach(([height], index) => {
    const axes = aboutZ(-radians(rotors[index]));
    poses.push({ position: at([0.014 * axes[0][0], 0.014 * axes[1][0], height]), axes: product(body.axes, axes) });
  });
  scene.boxes(boxes, poses);
}
function drawScene() {
  const floor = snapshot?.floor, telemetry = snapshot?.telemetry;
  const body = { position: [floor?.x ?? 0, floor?.y ?? 0, floor?.height ?? STANDING], axes: rotation(floor?.turn ?? [1, 0, 0, 0]) };
  const at = (p) => place(body, p);
  if (floor) {
    const before = last(way);
    if (!before || Math.hypot(before[0] - floor.x, before[1] - floor.y) > 0.01) way.push([floor.x, floor.y, 0.001]);
    if (way.length > 2000) way.shift();
    scene.camera.target = [floor.x, floor.y, 0.03];
  }
  scene.begin();
  scene.floor();
  scene.polyline(way, dark.matches ? "#6aa9ee" : "#2563a8", 2);
  // The front: an arrow on the floor.
  const down = (p) => { const [x, y] = at(p); return [x, y, 0.001]; };
  scene.arrow(down([0.15, 0, 0]), down([0.2, 0, 0]), dark.matches ? [154, 165, 181] : [90, 101, 119]);
  if (!drawWorld(scene, snapshot)) drawRobot(body, at);
  if (!telemetry) return;
  const line = (theta, reach) => [-reach, reach].map((r) => at([r * Math.cos(radians(theta)), -r * Math.sin(radians(theta)), SHAKER]));
  if (isWanted()) scene.polyline(line(snapshot.wanted[1], 0.17), dark.matches ? "#9aa5b5" : "#5a6577", 2, [6, 5]);
  if (turns(telemetry.frequency)) {
    const [back, front] = line(telemetry.direction, 0.14);
    scene.arrow(back, front, [214, 50, 40]);
    scene.arrow(front, back, [214, 50, 40]);
  }
}

// ---- figures
// Theta is where the rotors meet: at rest it means nothing.
const turns = (frequency) => Math.abs(frequency) > 1;
const history = [];
// Nobody reads faster, and a slow computer shows its newest snapshot sooner.
const WORDS_MS = 80;
const HISTORY_MS = 20000;
// A line over a longer time without telemetry would be made up.
const GAP_MS = 500;
const charted = {};
function chart(id, of, wantedOf, floorRange) {
  const canvas = byId(id), pen = canvas.getContext("2d"), ratio = devicePixelRatio;
  const values = history.flatMap((one) => [of(one), wantedOf(one)]).filter((value) => value !== undefined);
  // A line that fills the chart and is flat stays where it is.
  const newest = last(history)?.stamp, isFull = history[0]?.stamp < newest - HISTORY_MS + GAP_MS;
  const isFlat = isFull && values.every((value) => Math.abs(value - values[0]) < 0.05);
  const as = JSON.stringify([canvas.clientWidth, canvas.clientHeight, ratio, isFlat ? [figure(values[0], 1)] : newest]);
  if (charted[id] === as) return;
  charted[id] = as;
  const width = canvas.width = canvas.clientWidth * ratio, height = canvas.height = canvas.clientHeight * ratio;
  const middle = (Math.min(...values, 0) + Math.max(...values, 0)) / 2;
  const range = Math.max(floorRange, Math.max(...values, 0) - Math.min(...values, 0)) * 1.15;
  const end = last(history)?.stamp ?? 0;
  const draw = (pick, style, dash) => {
    pen.beginPath();
    let drawing = false, before = 0;
    for (const one of history) {
      const value = pick(one);
      if (one.stamp - before > GAP_MS) drawing = false;
      before = one.stamp;
      const x = width * (1 - (end - one.stamp) / HISTORY_MS), y = height * (0.5 - (value - middle) / range);
      if (value === undefined) drawing = false;
      else if (drawing) pen.lineTo(x, y);
      else { pen.moveTo(x, y); drawing = true; }
    }
    pen.strokeStyle = style; pen.lineWidth = 1.5 * ratio; pen.setLineDash(dash); pen.stroke();
  };
  const style = getComputedStyle(document.documentElement);
  draw(wantedOf, style.getPropertyValue("--commanded"), [4 * ratio, 3 * ratio]);
  draw(of, style.getPropertyValue("--measured"), []);
}
const figure = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace(/^-(?!0\.?0*$)/, "−").replace("-", ""));
const write = (id, text) => { const element = byId(id); if (element.textContent !== text) element.textContent = text; };

// ---- words
function banner() {
  const telemetry = snapshot?.telemetry;
  const now = performance.now(), unheard = now - unheardSince;
  const since = snapshot ? `this was ${figure(late / 1000, 0)} s ago` : `nothing has come for ${figure((now - arrivedAt) / 1000, 0)} s`;
  const slow = late > SILENT_MS && connection?.readyState === WebSocket.OPEN ? `The connection is slow: ${since}.` : "";
  if (unheard > STOP_ANSWER_MS || (!snapshot && unheard >= 0)) return [`${STOP_UNHEARD} ${slow}`.trim(), false];
  if (!snapshot) return [slow || NO_CONNECTION, false];
  if (snapshot.stopping) return [`Stop is sent, and not acknowledged yet. ${snapshot.link.state === "failed" ? `Stop the robot at its switch: ${snapshot.link.text}` : ""}`.trim(), false];
  if (slow) return [slow, false];
  if (snapshot.link.state === "failed") return [snapshot.link.text, false];
  if (telemetry?.faults.length) return [`${telemetry.faults.map((fault) => `${fault.name}: ${fault.help}`).join(". ")}. Then press Clear.`, false];
  if (telemetry?.stopped) return [`Stopped${telemetry.stopped_by ? ` by ${telemetry.stopped_by}` : ""}. Clear makes the robot ready again.`, false];
  if (!drives()) return ["This page watches. Its STOP stops the robot; to drive, take over.", true];
  return [];
}
function drawWords(gamepad) {
  const telemetry = snapshot?.telemetry;
  const state = !snapshot ? "no connection" : telemetry?.stopped ? "stopped" : telemetry?.state ?? snapshot.link.state;
  write("robot", snapshot?.robot ?? "Flix");
  write("state", state);
  byId("state").dataset.state = state;
  byId("state").title = telemetry?.text ?? "";
  const link = snapshot?.link;
  byId("link").className = link?.state === "connected" ? "" : "bad";
  write("link", !link || link.state === "connected" ? "" : link.text);
  const [text, calm] = banner();
  byId("banner").hidden = text === undefined;
  byId("banner").className = calm ? "calm" : "";
  byId("drive").hidden = !snapshot || drives();
  write("banner-text", text ?? "");
  const isDriven = drives() && !telemetry?.stopped && (telemetry?.state === "armed" || telemetry?.state === "running");
  const [f, theta] = snapshot?.wanted ?? [0, 0];
  for (const button of document.querySelectorAll("[data-mode]")) {
    const mode = modes.find(({ name }) => name === button.dataset.mode);
    const isOn = isDriven && (mode ? f === mode.pair[0] && theta === mode.pair[1] : f === 0);
    button.setAttribute("aria-pressed", String(isOn));
  }
  for (const button of document.querySelectorAll("#modes button, #values button")) button.disabled = !isDriven;
  for (const button of document.querySelectorAll(".row [data-do], #settings-save, #scope button")) button.disabled = !drives();
  const isIdle = telemetry?.state === "disarmed" || telemetry?.state === "faulted";
  for (const input of settingInputs.values()) input.disabled = !drives() || !isIdle;
  // A page that was slow for a moment was not heard.
  if (settings.open && !settingInputs.size && performance.now() - settingsAskedAt > ASK_AGAIN_MS) askForSettings();
  write("settings-note", settingInputs.size ? (isIdle ? "Changes hold until power-off, unless saved." : "Disarm to change settings.") : "");
  write("f", telemetry ? `${figure(telemetry.frequency, 1)} Hz` : "–");
  write("theta", telemetry && turns(telemetry.frequency) ? `${figure(telemetry.direction, 0)} deg` : "–");
  write("f-wanted", telemetry ? `commanded ${figure(f, 1)}${telemetry.limited ? ", limited" : ""}` : "");
  write("theta-wanted", telemetry ? `commanded ${figure(theta, 0)}` : "");
  ["top", "bottom"].forEach((id, index) => {
    byId(id).max = snapshot?.current_limit ?? 3;
    byId(id).value = telemetry?.currents[index] ?? 0;
    write(`${id}-value`, telemetry ? `${figure(telemetry.currents[index], 2)} A` : "–");
  });
  write("battery", telemetry ? (telemetry.battery === null ? "not measured" : `${figure(telemetry.battery, 1)} V`) : "–");
  write("quality", link?.round_trip_ms != null ? `${figure(link.round_trip_ms, 1)} ms, ${figure(100 * link.loss, 0)} % lost` : "–");
  write("gamepad", gamepad);
  write("note", [failed && `${failed} failed in this browser`, remark && performance.now() - remark.at < REMARKED_MS && remark.text, snapshot?.rests_in_s && snapshot.rests_in_s <= COUNTED_S && `rests in ${snapshot.rests_in_s} s unless you touch a key or the page`, snapshot?.is_unrecorded && "not recorded any more", snapshot && !snapshot.floor && "no poses: drawn where it stands (--pose)", snapshot?.slow_motion && "rotors 30 times slower", snapshot?.pages > 1 && `${snapshot.pages} pages open`].filter(Boolean).join(" · "));
  const log = snapshot?.log ?? [];
  const lines = log.map((line) => `${line.at.toFixed(1)} s  ${line.text}`).reverse();
  if (byId("log").dataset.lines !== lines.join("\n")) {
    byId("log").dataset.lines = lines.join("\n");
    byId("log").replaceChildren(...lines.map((text, index) => {
      const item = document.createElement("li");
      item.className = log[log.length - 1 - index].weight;
      item.textContent = text;
      return item;
    }));
  }
}

let written = 0, areWritten = false, newest, gamepad = "none";
// What an operator has to know before he begins or clears anything is written in the frame that draws it.
function isNews() {
  const { telemetry, stopping } = snapshot ?? {};
  const news = JSON.stringify([telemetry?.state, telemetry?.stopped, telemetry?.faults, stopping]);
  if (news === newest) return false;
  newest = news;
  return true;
}
function draw(now) {
  requestAnimationFrame(draw);
  noteFrame();
  watchConnection();
  watchHeld();
  attempt("the gamepad", () => { gamepad = readGamepads(now); });
  if (snapshot?.telemetry && last(history)?.stamp !== snapshot.stamp) {
    const { telemetry, wanted, stamp } = snapshot;
    history.push({ stamp, f: telemetry.frequency, theta: telemetry.direction, wanted });
    while (history[0].stamp < stamp - HISTORY_MS) history.shift();
  }
  attempt("the screen", keepAwake);
  attempt("the picture", () => {
    if (!scene) openScene();
    const now = picture();
    if (now !== pictured) drawScene();
    pictured = now;
  });
  if (isNews() || now - written >= WORDS_MS) {
    written = now;
    areWritten = false;
    attempt("the words", () => { drawWords(gamepad); areWritten = true; });
    attempt("the charts", () => {
      chart("f-chart", (one) => one.f, (one) => one.wanted[0], 10);
      chart("theta-chart", (one) => (turns(one.f) ? one.theta : undefined), (one) => one.wanted[1], 20);
    });
  }
  // An operator who does not see how the robot is drives none.
  if (snapshot && areWritten) shown = snapshot.stamp;
}
connect();
requestAnimationFrame(draw);
