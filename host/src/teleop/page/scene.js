// A floor with boxes, lines and arrows, seen by a camera that the pointer moves. Lengths in metres, world frame ENU,
// quaternions [w, x, y, z].
function rotation([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}
const place = (pose, p) => pose.position.map((c, i) =>
  c + pose.axes[i][0] * p[0] + pose.axes[i][1] * p[1] + pose.axes[i][2] * p[2]);
const colour = (rgb, light) => `rgb(${rgb.map((c) => Math.round(c * light)).join(" ")})`;

// `size` returns width and height of the canvas in CSS pixels; `moved` is called when the pointer moves the camera
// over the floor; `grid` names the colours of the floor's lines, `edge` that of the boxes' edges.
function createScene(canvas, { size, moved = () => {}, look = () => ({ grid: ["#dde1e7", "#aab3c0"], edge: "#00000026" }) }) {
  const pen = canvas.getContext("2d");
  const camera = { azimuth: -0.9, elevation: 0.5, distance: 0.75, target: [0, 0, 0.04] };

  // ---- the camera: world to pixels; depth grows away from the eye
  let eye, right, up, forward, focal;
  function begin() {
    const ratio = devicePixelRatio, [width, height] = size();
    if (canvas.width !== width * ratio || canvas.height !== height * ratio) {
      canvas.width = width * ratio; canvas.height = height * ratio;
    }
    const { azimuth, elevation, distance, target } = camera;
    forward = [-Math.cos(elevation) * Math.cos(azimuth), -Math.cos(elevation) * Math.sin(azimuth), -Math.sin(elevation)];
    right = [-Math.sin(azimuth), Math.cos(azimuth), 0];
    up = [right[1] * forward[2] * 1 - right[2] * forward[1], right[2] * forward[0] - right[0] * forward[2], right[0] * forward[1] - right[1] * forward[0]];
    eye = target.map((c, i) => c - forward[i] * distance);
    focal = 1.1 * Math.min(canvas.width, canvas.height * 1.4);
    pen.clearRect(0, 0, canvas.width, canvas.height);
  }
  function project(p) {
    const d = [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]];
    const depth = d[0] * forward[0] + d[1] * forward[1] + d[2] * forward[2];
    if (depth < 0.02) return null;
    const x = d[0] * right[0] + d[1] * right[1] + d[2] * right[2];
    const y = d[0] * up[0] + d[1] * up[1] + d[2] * up[2];
    return [canvas.width / 2 + focal * x / depth, canvas.height / 2 - focal * y / depth, depth];
  }

  // Returns the point of the floor at this place of the canvas, CSS pixels; nothing above the horizon.
  function ground(x, y) {
    const ratio = devicePixelRatio;
    const across = (x * ratio - canvas.width / 2) / focal, upward = (canvas.height / 2 - y * ratio) / focal;
    const ray = forward.map((c, i) => c + across * right[i] + upward * up[i]);
    if (ray[2] >= 0) return null;
    const reach = -eye[2] / ray[2];
    return [eye[0] + reach * ray[0], eye[1] + reach * ray[1]];
  }

  // ---- drawing
  const FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
  const LIGHT = [0.35, -0.45, 0.82];
  function polyline(points, style, width, dash = []) {
    pen.beginPath();
    let drawing = false;
    for (const point of points) {
      const at = project(point);
      if (!at) { drawing = false; continue; }
      if (drawing) pen.lineTo(at[0], at[1]); else pen.moveTo(at[0], at[1]);
      drawing = true;
    }
    pen.strokeStyle = style;
    pen.lineWidth = width * devicePixelRatio;
    pen.setLineDash(dash.map((d) => d * devicePixelRatio));
    pen.stroke();
    pen.setLineDash([]);
  }
  function floor() {
    const pitch = camera.distance > 4 ? 0.5 : 0.1, reach = 14;
    const [weak, strong] = look().grid;
    const cx = Math.round(camera.target[0] / pitch), cy = Math.round(camera.target[1] / pitch);
    for (let i = -reach; i <= reach; i++) {
      const style = (k) => ((k % (pitch === 0.1 ? 10 : 2)) === 0 ? strong : weak);
      polyline([[(cx + i) * pitch, (cy - reach) * pitch, 0], [(cx + i) * pitch, (cy + reach) * pitch, 0]], style(cx + i), 1);
      polyline([[(cx - reach) * pitch, (cy + i) * pitch, 0], [(cx + reach) * pitch, (cy + i) * pitch, 0]], style(cy + i), 1);
    }
  }
  function faces(part, pose, list) {
    const h = part.half_size;
    const corners = [];
    for (let i = 0; i < 8; i++) corners.push(place(pose, [i & 1 ? h[0] : -h[0], i & 2 ? h[1] : -h[1], i & 4 ? h[2] : -h[2]]));
    for (const face of FACES) {
      const [a, b, c] = face.map((i) => corners[i]);
      const u = [b[0] - a[0], b[1] - a[1], b[2] - a[2]], v = [c[0] - b[0], c[1] - b[1], c[2] - b[2]];
      let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const length = Math.hypot(...n) || 1;
      const middle = face.reduce((m, i) => m.map((c0, k) => c0 + corners[i][k] / 4), [0, 0, 0]);
      if (n[0] * (middle[0] - pose.position[0]) + n[1] * (middle[1] - pose.position[1]) + n[2] * (middle[2] - pose.position[2]) < 0) n = n.map((c0) => -c0);
      if (n[0] * (middle[0] - eye[0]) + n[1] * (middle[1] - eye[1]) + n[2] * (middle[2] - eye[2]) > 0) continue;
      const points = face.map((i) => project(corners[i]));
      if (points.some((p) => !p)) continue;
      const light = 0.62 + 0.38 * Math.max(0, (n[0] * LIGHT[0] + n[1] * LIGHT[1] + n[2] * LIGHT[2]) / length);
      const depth = points.reduce((sum, p) => sum + p[2], 0) / 4;
      list.push({ depth, points, fill: colour(part.colour, light) });
    }
  }
  // `parts`: half_size and colour; `poses`: position and axes (the columns of a rotation), one for each.
  function boxes(parts, poses) {
    const list = [];
    parts.forEach((part, index) => faces(part, poses[index], list));
    list.sort((a, b) => b.depth - a.depth);
    const { edge } = look();
    for (const face of list) {
      pen.beginPath();
      face.points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
      pen.closePath();
      pen.fillStyle = face.fill; pen.fill();
      pen.strokeStyle = edge; pen.lineWidth = devicePixelRatio; pen.stroke();
    }
  }
  function arrow(at, tip, rgb) {
    const a = project(at), b = project(tip);
    if (!a || !b) return;
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 2) return;
    pen.strokeStyle = pen.fillStyle = colour(rgb, 1);
    pen.lineWidth = 2.5 * devicePixelRatio;
    pen.beginPath(); pen.moveTo(a[0], a[1]); pen.lineTo(b[0], b[1]); pen.stroke();
    const head = Math.min(9 * devicePixelRatio, length * 0.6), t = Math.atan2(b[1] - a[1], b[0] - a[0]);
    pen.beginPath(); pen.moveTo(b[0], b[1]);
    pen.lineTo(b[0] - head * Math.cos(t - 0.4), b[1] - head * Math.sin(t - 0.4));
    pen.lineTo(b[0] - head * Math.cos(t + 0.4), b[1] - head * Math.sin(t + 0.4));
    pen.fill();
  }

  // ---- the pointer
  const zoom = (factor) => { camera.distance = Math.min(12, Math.max(0.15, camera.distance * factor)); };
  function move(dx, dy) {
    moved();
    const s = camera.distance / 700;
    camera.target = camera.target.map((c, i) => (i === 2 ? c : c - s * (dx * right[i] - dy * up[i])));
  }
  const pointers = new Map();
  canvas.onpointerdown = (event) => { canvas.setPointerCapture(event.pointerId); pointers.set(event.pointerId, event); };
  canvas.onpointerup = canvas.onpointercancel = (event) => pointers.delete(event.pointerId);
  canvas.onpointermove = (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    pointers.set(event.pointerId, event);
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    if (pointers.size === 2) {
      // Two fingers: their distance zooms, their middle moves.
      const other = [...pointers.values()].find((pointer) => pointer.pointerId !== event.pointerId);
      const apart = (finger) => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY);
      zoom(Math.max(1, apart(before)) / Math.max(1, apart(event)));
      move(dx / 2, dy / 2);
    } else if (event.shiftKey) {
      move(dx, dy);
    } else {
      camera.azimuth -= dx * 0.008;
      camera.elevation = Math.min(1.55, Math.max(-0.1, camera.elevation + dy * 0.008));
    }
  };
  canvas.onwheel = (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY * 0.001)); };

  return { camera, begin, ground, polyline, floor, boxes, arrow };
}
