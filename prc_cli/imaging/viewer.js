"use strict";
(async () => {
  const $ = (id) => document.getElementById(id);
  const about = JSON.parse($("about").textContent);
  const { lines, columns, classes, planes, box } = about;
  const nCells = lines.n * columns.n;
  if (typeof DecompressionStream === "undefined") {
    $("problem").textContent = "This browser is too old for the page: it needs one of 2023 or later.";
    $("problem").hidden = false;
    return;
  }

  // ---- data: planes of little-endian integers, byte by byte, differences along the shots, deflated, base64
  async function inflate(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }
  async function unpack(name) {
    const { bytes, n } = planes[name];
    const node = $("plane-" + name), raw = await inflate(node.textContent);
    node.remove();
    const found = bytes === 1 ? new Uint8Array(n) : bytes === 2 ? new Uint16Array(n) : new Uint32Array(n);
    const mask = bytes === 4 ? 0xffffffff : 2 ** (8 * bytes) - 1;
    let last = 0;
    for (let i = 0; i < n; i++) {
      let value = 0;
      for (let k = 0; k < bytes; k++) value |= raw[k * n + i] << (8 * k);
      last = ((last + value) & mask) >>> 0;
      found[i] = last;
    }
    return found;
  }
  const data = {};
  for (const name of Object.keys(planes)) data[name] = await unpack(name);
  // 0 = none, else offset + scale * (integer - 1)
  const valueOf = (name, i) => {
    const { scale, offset } = planes[name], found = data[name][i];
    return found === 0 ? NaN : offset + scale * (found - 1);
  };

  // ---- points: the cells that have a place in space
  const cellOf = new Int32Array(planes.x ? planes.x.n : 0);
  let nPoints = 0;
  if (planes.x) for (let i = 0; i < nCells; i++) if (data.x[i]) cellOf[nPoints++] = i;
  const X = new Float32Array(nPoints), Y = new Float32Array(nPoints), Z = new Float32Array(nPoints);
  const kind = new Uint8Array(nPoints);
  for (let p = 0; p < nPoints; p++) {
    const i = cellOf[p];
    X[p] = (data.x[i] - 1) * planes.x.scale + planes.x.offset - box.centre[0];
    Y[p] = (data.y[i] - 1) * planes.y.scale + planes.y.offset - box.centre[1];
    Z[p] = (data.z[i] - 1) * planes.z.scale + planes.z.offset - box.centre[2];
    kind[p] = data.class[i];
  }

  // ---- state
  const visible = new Uint8Array(256).fill(1);
  for (const one of classes) visible[one.place] = one.hidden ? 0 : 1;
  const palette = new Uint32Array(256).fill(0xffb4b4b4);
  const pack = (r, g, b) => (255 << 24 | b << 16 | g << 8 | r) >>> 0;
  for (const one of classes) palette[one.place] = pack(...one.colour);
  const ramp = about.ramp.map((one) => pack(...one));
  let mode = "class", scaled = null, chosen = -1, base = pack(255, 255, 255), paper = pack(255, 255, 255), pick = "#c2007a";

  let painter = null;
  function colourOf(i) {
    const colour = mode === "class" ? palette[data.class[i]] : data[mode][i] ? ramp[scaled[i]] : base;
    return painter ? painter.tint(colour, i) : colour;
  }
  function setMode(name) {
    mode = name;
    $("scale").hidden = name === "class";
    if (name === "class") { scaled = null; return; }
    const { low, high, log } = planes[name], turn = (v) => log ? Math.log(Math.max(v, 1e-6)) : v;
    const from = turn(low), span = Math.max(turn(high) - from, 1e-9);
    scaled = new Uint8Array(nCells);
    for (let i = 0; i < nCells; i++) {
      if (!data[name][i]) continue;
      const place = Math.min(1, Math.max(0, (turn(valueOf(name, i)) - from) / span));
      scaled[i] = Math.round(255 * (log ? 1 - place : place));
    }
    const strip = $("ramp").getContext("2d"), image = strip.createImageData(256, 1), out = new Uint32Array(image.data.buffer);
    for (let i = 0; i < 256; i++) out[i] = ramp[log ? 255 - i : i];
    strip.putImageData(image, 0, 0);
    $("low").textContent = number(low, planes[name]);
    $("high").textContent = number(high, planes[name]) + (planes[name].unit ? " " + planes[name].unit : "");
  }
  const number = (value, { digits }) => value.toFixed(digits);

  // ---- canvases
  const dense = Math.min(window.devicePixelRatio || 1, 1.5);
  function fitCanvas(canvas) {
    const width = Math.max(1, Math.round(canvas.clientWidth * dense)), height = Math.max(1, Math.round(canvas.clientHeight * dense));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; return true; }
    return false;
  }
  const at = (canvas, event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * canvas.width / box.width, (event.clientY - box.top) * canvas.height / box.height];
  };

  // ---- cloud: drawn by hand, so that any browser shows the same, with the nearest point of every pixel known
  const cloud = $("cloud"), cloudPen = cloud.getContext("2d");
  const RAD = Math.PI / 180, FOV = 40 * RAD;
  const view = { azimuth: 0, up: 0, away: 1, whole: 1, target: [0, 0, 0] };
  const hint = $("cloud-hint").textContent;
  let depths = new Float32Array(0), ids = new Int32Array(0), sheet = null, fast = false, later = 0, queued = false;
  function axes() {
    const a = view.azimuth * RAD, e = view.up * RAD;
    const out = [Math.sin(a) * Math.cos(e), Math.cos(a) * Math.cos(e), Math.sin(e)], right = [-Math.cos(a), Math.sin(a), 0];
    const front = out.map((v) => -v);
    const down = [front[1] * right[2] - front[2] * right[1], front[2] * right[0] - front[0] * right[2], front[0] * right[1] - front[1] * right[0]];
    return { right, down, front };
  }
  function fitCloud(azimuth = box.azimuth, up = 30) {
    view.azimuth = azimuth; view.up = up; view.target = [0, 0, 0];
    fitCanvas(cloud);
    const { right, down, front } = axes(), tall = Math.tan(FOV / 2), wide = tall * cloud.width / cloud.height;
    // the nearest eye that sees all points of the box, then moved so that they are in the middle
    const [hx, hy, hz] = box.size.map((v) => v / 2), inside = [];
    for (let q = 0, step = Math.max(1, nPoints >> 16); q < nPoints; q += step)
      if (visible[kind[q]] && Math.abs(X[q]) <= hx && Math.abs(Y[q]) <= hy && Math.abs(Z[q]) <= hz) inside.push(q);
    const dot = (axis, q) => axis[0] * X[q] + axis[1] * Y[q] + axis[2] * Z[q];
    const seen = inside.map((q) => [dot(right, q), dot(down, q), dot(front, q)]);
    let middle = [0, 0], away = 1;
    for (let round = 0; round < 3; round++) {
      away = 1;
      for (const [x, y, z] of seen) away = Math.max(away, Math.abs(x - middle[0]) / wide - z, Math.abs(y - middle[1]) / tall - z);
      const ends = [Infinity, -Infinity, Infinity, -Infinity];
      for (const [x, y, z] of seen) {
        const s = away / (away + z), px = (x - middle[0]) * s, py = (y - middle[1]) * s;
        ends[0] = Math.min(ends[0], px); ends[1] = Math.max(ends[1], px); ends[2] = Math.min(ends[2], py); ends[3] = Math.max(ends[3], py);
      }
      if (round < 2 && seen.length) { middle[0] += (ends[0] + ends[1]) / 2; middle[1] += (ends[2] + ends[3]) / 2; }
    }
    view.target = view.target.map((_, k) => right[k] * middle[0] + down[k] * middle[1]);
    view.away = view.whole = away * 1.03;
    redraw();
  }
  function projection() {
    const { right, down, front } = axes(), focal = cloud.height / 2 / Math.tan(FOV / 2);
    return { right, down, front, focal, cx: cloud.width / 2, cy: cloud.height / 2 };
  }
  function place(p, x, y, z) {
    const [tx, ty, tz] = view.target, dx = x - tx, dy = y - ty, dz = z - tz;
    const depth = dx * p.front[0] + dy * p.front[1] + dz * p.front[2] + view.away, s = p.focal / depth;
    return [(dx * p.right[0] + dy * p.right[1]) * s + p.cx, (dx * p.down[0] + dy * p.down[1] + dz * p.down[2]) * s + p.cy, depth];
  }
  function drawCloud() {
    const width = cloud.width, height = cloud.height, n = width * height;
    if (depths.length !== n) { depths = new Float32Array(n); ids = new Int32Array(n); sheet = cloudPen.createImageData(width, height); }
    depths.fill(Infinity); ids.fill(-1);
    const p = projection(), [tx, ty, tz] = view.target, [r0, r1] = p.right, [d0, d1, d2] = p.down, [f0, f1, f2] = p.front;
    const step = fast ? Math.max(1, Math.ceil(nPoints / 250000)) : 1;
    const size = Number($("size").value) + (fast && step > 1 ? 1 : 0) + (n > nPoints * 4 ? 1 : 0), near = view.away * 0.02;
    for (let q = 0; q < nPoints; q += step) {
      if (!visible[kind[q]]) continue;
      const dx = X[q] - tx, dy = Y[q] - ty, dz = Z[q] - tz, depth = dx * f0 + dy * f1 + dz * f2 + view.away;
      if (depth < near) continue;
      const s = p.focal / depth, px = ((dx * r0 + dy * r1) * s + p.cx) | 0, py = ((dx * d0 + dy * d1 + dz * d2) * s + p.cy) | 0;
      if (px < 0 || py < 0 || px >= width || py >= height) continue;
      const reach = Math.min(5, Math.max(0, Math.round(size * view.away / depth)));
      const x0 = Math.max(0, px - (reach >> 1)), x1 = Math.min(width - 1, px + ((reach + 1) >> 1));
      const y0 = Math.max(0, py - (reach >> 1)), y1 = Math.min(height - 1, py + ((reach + 1) >> 1));
      for (let y = y0; y <= y1; y++) for (let k = y * width + x0, end = y * width + x1; k <= end; k++)
        if (depth < depths[k]) { depths[k] = depth; ids[k] = q; }
    }
    const out = new Uint32Array(sheet.data.buffer);
    for (let k = 0; k < n; k++) {
      const q = ids[k];
      if (q < 0) { out[k] = paper; continue; }
      const colour = colourOf(cellOf[q]);
      // edges: darker where neighbours are in front (eye-dome lighting, Boucheny 2009)
      let deeper = 0;
      const own = depths[k];
      for (const other of [k - 1, k + 1, k - width, k + width, k - 2, k + 2, k - 2 * width, k + 2 * width])
        if (other >= 0 && other < n && depths[other] < own) deeper += Math.min(0.06, Math.log2(own / depths[other]));
      const light = Math.max(0.35, Math.exp(-4 * deeper));
      out[k] = pack((colour & 255) * light, (colour >> 8 & 255) * light, (colour >> 16 & 255) * light);
    }
    cloudPen.putImageData(sheet, 0, 0);
    $("cloud-hint").textContent = ids.some((q) => q >= 0) ? hint : "Nothing is in view: press Fit, or switch classes on.";
    if (chosen >= 0 && planes.x && data.x[chosen]) {
      const [x, y, depth] = place(p, ...[0, 1, 2].map((k) => valueOf("xyz"[k], chosen) - box.centre[k]));
      if (depth > near) ring(cloudPen, x, y);
    }
  }
  function ring(pen, x, y) {
    for (const [colour, width] of [["#fff", 5], [pick, 2.5]]) {
      pen.strokeStyle = colour; pen.lineWidth = width * dense;
      pen.beginPath(); pen.arc(x, y, 9 * dense, 0, 2 * Math.PI); pen.stroke();
    }
  }
  function pointNear(x, y) {
    const reach = Math.round(9 * dense), width = cloud.width;
    let best = -1, nearest = Infinity;
    for (let dy = -reach; dy <= reach; dy++) for (let dx = -reach; dx <= reach; dx++) {
      const px = Math.round(x) + dx, py = Math.round(y) + dy;
      if (px < 0 || py < 0 || px >= width || py >= cloud.height) continue;
      const q = ids[py * width + px], far = dx * dx + dy * dy;
      if (q >= 0 && far < nearest) { nearest = far; best = q; }
    }
    return best < 0 ? -1 : cellOf[best];
  }
  function turn(dx, dy) { view.azimuth = (view.azimuth + dx + 360) % 360; view.up = Math.max(-89.9, Math.min(90, view.up + dy)); }
  function shift(dx, dy) {
    const { right, down } = axes(), s = view.away / (cloud.height / 2 / Math.tan(FOV / 2));
    view.target = view.target.map((v, k) => v - (right[k] * dx + down[k] * dy) * s);
  }
  function drawnNear(x, y) {
    let best = -1, nearest = Infinity;
    for (let k = 0; k < ids.length; k++) {
      if (ids[k] < 0) continue;
      const dx = k % cloud.width - x, dy = Math.floor(k / cloud.width) - y, far = dx * dx + dy * dy;
      if (far < nearest) { nearest = far; best = ids[k]; }
    }
    return best;
  }
  // towards the point nearest to the pointer, never through it; and never so far that the cloud is lost
  const NEAREST = 0.5, FARTHEST = 3;
  function zoomCloud(factor, x = cloud.width / 2, y = cloud.height / 2) {
    const q = drawnNear(x, y), farthest = view.whole * FARTHEST;
    if (q < 0 && factor > 1) return;
    const { right, down, front, focal, cx, cy } = projection();
    if (q >= 0) {
      const [px, py, depth] = place(projection(), X[q], Y[q], Z[q]);
      if (depth > 0) {
        view.target = view.target.map((v, k) => v + front[k] * (depth - view.away));
        view.away = depth; x = px; y = py;
      }
    }
    const away = Math.max(Math.min(NEAREST, view.away), Math.min(view.away / factor, farthest));
    const moved = (view.away - away) / focal;
    view.target = view.target.map((v, k) => v + (right[k] * (x - cx) + down[k] * (y - cy)) * moved);
    view.away = away;
    if (away >= farthest) view.target = [0, 0, 0];
  }

  // ---- range image: tiles of cells, one pixel each, drawn enlarged
  const image = $("image"), imagePen = image.getContext("2d");
  const TILE = 2048, order = about.order, rowOf = new Int32Array(columns.n);
  order.forEach((column, row) => { rowOf[column] = row; });
  const across = (i) => about.mirrored ? lines.n - 1 - i : i;
  const look = { x: 0, y: 0, zoom: 1 };
  let tiles = [];
  function makeTiles() {
    tiles = [];
    for (let first = 0; first < lines.n; first += TILE) {
      const wide = Math.min(TILE, lines.n - first), tile = document.createElement("canvas");
      tile.width = wide; tile.height = columns.n;
      const pen = tile.getContext("2d"), pixels = pen.createImageData(wide, columns.n), out = new Uint32Array(pixels.data.buffer);
      for (let x = 0; x < wide; x++) {
        const line = across(first + x) * columns.n;
        for (let y = 0; y < columns.n; y++) out[y * wide + x] = pixelOf(line + order[y]);
      }
      pen.putImageData(pixels, 0, 0);
      tiles.push({ first, tile, pen, pixels, out });
    }
  }
  const pixelOf = (i) => data.class[i] && visible[data.class[i]] ? colourOf(i) : painter ? painter.tint(base, i) : base;
  // only the pixels of some cells, and only the part of each tile that they are in
  function repaintCells(cells) {
    const ends = tiles.map(() => [Infinity, Infinity, -1, -1]);
    for (const i of cells) {
      const place = across(Math.floor(i / columns.n)), number = Math.floor(place / TILE), x = place % TILE, y = rowOf[i % columns.n], end = ends[number];
      tiles[number].out[y * tiles[number].tile.width + x] = pixelOf(i);
      if (x < end[0]) end[0] = x;
      if (y < end[1]) end[1] = y;
      if (x > end[2]) end[2] = x;
      if (y > end[3]) end[3] = y;
    }
    ends.forEach(([x0, y0, x1, y1], number) => {
      if (x1 >= 0) tiles[number].pen.putImageData(tiles[number].pixels, 0, 0, x0, y0, x1 - x0 + 1, y1 - y0 + 1);
    });
  }
  const scales = () => [image.width / lines.n * look.zoom, image.height / columns.n * look.zoom];
  function drawImage() {
    const [sx, sy] = scales();
    look.x = Math.max(0, Math.min(look.x, lines.n - image.width / sx));
    look.y = Math.max(0, Math.min(look.y, columns.n - image.height / sy));
    imagePen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--view");
    imagePen.fillRect(0, 0, image.width, image.height);
    imagePen.imageSmoothingEnabled = false;
    for (const { first, tile } of tiles) imagePen.drawImage(tile, (first - look.x) * sx, -look.y * sy, tile.width * sx, tile.height * sy);
    if (painter) painter.draw(imagePen);
    if (chosen >= 0 && !(painter && painter.isOn)) ring(imagePen, (across(Math.floor(chosen / columns.n)) + 0.5 - look.x) * sx, (rowOf[chosen % columns.n] + 0.5 - look.y) * sy);
  }
  function cellAt(x, y) {
    const [sx, sy] = scales(), i = Math.floor(x / sx + look.x), row = Math.floor(y / sy + look.y);
    return i < 0 || row < 0 || i >= lines.n || row >= columns.n ? -1 : across(i) * columns.n + order[row];
  }
  function zoomImage(factor, x = image.width / 2, y = image.height / 2) {
    const [sx, sy] = scales(), zoom = Math.max(1, Math.min(look.zoom * factor, 400));
    factor = zoom / look.zoom;
    look.x += x / sx * (1 - 1 / factor); look.y += y / sy * (1 - 1 / factor); look.zoom = zoom;
  }

  // ---- choosing a shot
  const nameOf = (place) => { const one = classes.find((each) => each.place === place); return one ? one.name : "no return"; };
  function choose(i) {
    chosen = i;
    $("nothing").hidden = i >= 0;
    $("why").hidden = !(i >= 0 && about.why && data.class[i]);
    const rows = [];
    if (i >= 0) {
      const line = Math.floor(i / columns.n), column = i % columns.n;
      rows.push(["line", lines.first + line * lines.step], ["column", columns.first + column * columns.step]);
      rows.push(["class", nameOf(data.class[i])]);
      $("why").querySelector("code").textContent = `${about.why} ${rows[0][1]},${rows[1][1]}`;
      for (const [name, plane] of Object.entries(planes)) {
        if (name === "class") continue;
        const value = valueOf(name, i);
        if (Number.isNaN(value)) continue;
        const word = plane.words ? plane.words[value] : null;
        rows.push([plane.title, word || number(value, plane) + (plane.unit ? " " + plane.unit : "")]);
      }
      const [sx, sy] = scales(), x = across(line), y = rowOf[column];
      if (x < look.x || x > look.x + image.width / sx) look.x = x - image.width / sx / 2;
      if (y < look.y || y > look.y + image.height / sy) look.y = y - image.height / sy / 2;
    }
    $("shot").replaceChildren(...rows.flatMap(([term, value]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = term; dd.textContent = value;
      return [dt, dd];
    }));
    redraw();
  }

  // ---- drawing on demand
  let isCloudOld = false;
  function redraw(isCloud = true) {
    isCloudOld = isCloudOld || isCloud !== false;
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => {
      queued = false;
      if (fitCanvas(cloud)) isCloudOld = true;
      fitCanvas(image);
      if (nPoints && isCloudOld) drawCloud();
      isCloudOld = false;
      drawImage();
    });
  }
  function moving() {
    fast = true; redraw();
    drawSlowly(160);
  }
  // every point of the cloud, when nothing moves any more
  function drawSlowly(after) {
    clearTimeout(later);
    later = setTimeout(() => { if (painter && painter.isBusy) drawSlowly(after); else { fast = false; redraw(); } }, after);
  }
  function repaint() { makeTiles(); redraw(); }
  function theme() {
    const style = getComputedStyle(document.documentElement), hex = style.getPropertyValue("--view").trim();
    const value = parseInt(hex.length === 4 ? hex.slice(1).replace(/./g, "$&$&") : hex.slice(1), 16);
    paper = pack(value >> 16, value >> 8 & 255, value & 255); base = paper;
    pick = style.getPropertyValue("--pick").trim();
    repaint();
  }

  // ---- pointers: one turns or moves, two zoom and move
  function watch(canvas, drag, zoom, click, hover) {
    const down = new Map();
    let moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId); canvas.focus({ preventScroll: true });
      down.set(event.pointerId, at(canvas, event));
      if (down.size === 1) moved = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = at(canvas, event), before = down.get(event.pointerId);
      if (!before) { if (hover) hover(now); return; }
      const dx = now[0] - before[0], dy = now[1] - before[1];
      moved += Math.abs(dx) + Math.abs(dy);
      if (down.size === 2) {
        const other = [...down].find(([id]) => id !== event.pointerId)[1];
        const reach = (a) => Math.hypot(a[0] - other[0], a[1] - other[1]);
        zoom(reach(now) / Math.max(1, reach(before)), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
        drag(dx / 2, dy / 2, true);
      } else if (moved > 4 * dense) drag(dx, dy, event.shiftKey || (event.buttons & 6) !== 0);
      down.set(event.pointerId, now);
      if (moved > 4 * dense) moving();
    });
    const end = (event) => {
      if (down.delete(event.pointerId) && event.type === "pointerup" && !down.size && moved <= 4 * dense) click(...at(canvas, event));
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...at(canvas, event));
      moving();
    }, { passive: false });
  }
  watch(cloud, (dx, dy, isShift) => (isShift ? shift(dx, dy) : turn(dx * 0.3 / dense, dy * 0.3 / dense)), zoomCloud, (x, y) => choose(pointNear(x, y)));
  watch(image, (dx, dy) => { const [sx, sy] = scales(); look.x -= dx / sx; look.y -= dy / sy; }, zoomImage, (x, y) => choose(cellAt(x, y)), ([x, y]) => {
    const i = cellAt(x, y);
    $("image-hint").textContent = i < 0 ? "" : `line ${lines.first + Math.floor(i / columns.n) * lines.step}, column ${columns.first + i % columns.n * columns.step}`;
  });
  image.addEventListener("pointerleave", () => { $("image-hint").textContent = ""; });

  // ---- labels by hand
  const cellOfCursor = () => chosen < 0 ? null : [across(Math.floor(chosen / columns.n)), rowOf[chosen % columns.n]];
  const recordOf = (i) => data.record && data.record[i] ? Math.round(valueOf("record", i)) : "";
  painter = labelsByHand(about.paint, image, {
    width: lines.n, height: columns.n, dense,
    cell: (x, y) => { const i = across(x) * columns.n + order[y]; return data.range[i] ? i : -1; },
    range: (x, y) => { const code = data.range[across(x) * columns.n + order[y]]; return code ? planes.range.offset + planes.range.scale * (code - 1) : 0; },
    view: () => { const [wide, tall] = scales(); return { x: look.x, y: look.y, wide, tall }; },
    cursor: cellOfCursor,
    changed(cells, isFinished) {
      repaintCells(cells);
      redraw(false);
      if (isFinished) drawSlowly(700);
    },
    redraw: () => redraw(false),
    // the predicted classes would lead the hand: ranges are shown, until another colour is chosen
    switched(isOn) {
      if (isOn && mode === "class") { setMode("range"); $("colours").value = "range"; repaint(); }
    },
    pan(dx, dy) { const [sx, sy] = scales(); look.x -= dx / sx; look.y -= dy / sy; },
    zoom: (factor, x, y) => zoomImage(factor, x, y),
    columns: ["record", "scan_line", "column"],
    identify: (i) => [recordOf(i), lines.first + Math.floor(i / columns.n) * lines.step, columns.first + i % columns.n * columns.step].join(","),
    find(rows) {
      const byRecord = new Map();
      if (data.record && rows.some((one) => Number.isNaN(one.line))) for (let i = 0; i < nCells; i++) if (data.record[i]) byRecord.set(recordOf(i), i);
      return rows.map((one) => {
        const line = (one.line - lines.first) / lines.step, column = (one.column - columns.first) / columns.step;
        const isCell = Number.isInteger(line) && Number.isInteger(column) && line >= 0 && column >= 0 && line < lines.n && column < columns.n;
        const i = isCell ? line * columns.n + column : byRecord.has(one.record) ? byRecord.get(one.record) : -1;
        return i >= 0 && data.range[i] ? i : -1;
      });
    },
  });

  const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  cloud.addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (step && event.shiftKey) shift(-step[0] * 40, -step[1] * 40);
    else if (step) turn(step[0] * 5, -step[1] * 5);
    else if (event.key === "+" || event.key === "=") zoomCloud(1.2);
    else if (event.key === "-") zoomCloud(1 / 1.2);
    else if (event.key === "0") fitCloud();
    else if (event.key === "Enter") choose(pointNear(cloud.width / 2, cloud.height / 2));
    else return;
    event.preventDefault(); moving();
  });
  image.addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (step) {
      const by = event.shiftKey ? 10 : 1;
      const x = chosen < 0 ? Math.floor(lines.n / 2) : across(Math.floor(chosen / columns.n)) + step[0] * by;
      const y = chosen < 0 ? Math.floor(columns.n / 2) : rowOf[chosen % columns.n] + step[1] * by;
      choose(across(Math.max(0, Math.min(x, lines.n - 1))) * columns.n + order[Math.max(0, Math.min(y, columns.n - 1))]);
    } else if (event.key === "+" || event.key === "=") zoomImage(1.4);
    else if (event.key === "-") zoomImage(1 / 1.4);
    else if (event.key === "0") look.zoom = 1;
    else return;
    event.preventDefault(); moving();
  });
  for (const button of document.querySelectorAll("button[data-do]")) button.addEventListener("click", () => {
    const isCloud = button.dataset.for === "cloud", act = button.dataset.do;
    if (act === "fit") { if (isCloud) fitCloud(); else look.zoom = 1; }
    else if (act === "top") fitCloud(180, 90);
    else (isCloud ? zoomCloud : zoomImage)(act === "in" ? 1.4 : 1 / 1.4);
    redraw();
  });

  // ---- legend and colours
  $("legend").append(...classes.map((one) => {
    const item = document.createElement("li"), label = document.createElement("label"), box = document.createElement("input");
    const chip = document.createElement("span"), share = document.createElement("small");
    box.type = "checkbox"; box.checked = !one.hidden;
    chip.style.background = `rgb(${one.colour.join(",")})`;
    share.textContent = one.share;
    label.append(box, chip, one.name, share); item.append(label);
    box.addEventListener("change", () => { visible[one.place] = box.checked ? 1 : 0; repaint(); });
    return item;
  }));
  for (const [name, plane] of Object.entries(planes)) {
    if (plane.low === undefined && name !== "class") continue;
    const option = document.createElement("option");
    option.value = name; option.textContent = plane.title;
    $("colours").append(option);
  }
  $("colours").addEventListener("change", (event) => { setMode(event.target.value); repaint(); });
  $("size").addEventListener("input", redraw);
  if (!nPoints) $("cloud-hint").textContent = "The input holds nothing to place the shots in space by.";
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  new ResizeObserver(redraw).observe(document.querySelector(".views"));
  theme();
  if (nPoints) fitCloud();
  function goTo() {
    const wanted = /^#(\d+),(\d+)$/.exec(location.hash);
    if (!wanted) return;
    const line = Math.round((wanted[1] - lines.first) / lines.step), column = Math.round((wanted[2] - columns.first) / columns.step);
    if (line >= 0 && line < lines.n && column >= 0 && column < columns.n) choose(line * columns.n + column);
  }
  addEventListener("hashchange", goTo);
  goTo();
  document.body.dataset.ready = String(nPoints);
})();
