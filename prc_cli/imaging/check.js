"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const about = JSON.parse($("about").textContent);
  const { answers, places } = about;
  const CANNOT_TELL = "cannot tell", OTHER = "other";
  function complain(text) { $("problem").textContent = text; $("problem").hidden = false; }
  if (typeof DecompressionStream === "undefined") {
    complain("This browser is too old for the page: it needs one of 2023 or later.");
    return;
  }

  // ---- answers: kept in the browser under a name that only this sample has
  const kept = `prc-check ${answers.classified.sha256} ${answers.seed} ${places.length}`;
  const cellName = (one) => [one.scanner, one.line, one.column].join(" ");
  const past = []; // places in the order in which they were answered
  let now = 0;
  function keep() {
    try { localStorage.setItem(kept, JSON.stringify(answers)); } catch { complain("The browser does not keep your answers: save them before you close the page."); }
  }
  function takeOver(other) {
    if (!other || other.kind !== answers.kind) throw new Error("It is no answers file.");
    if (other.classified.sha256 !== answers.classified.sha256) throw new Error(`Its answers are about another file, ${other.classified.name}.`);
    const known = new Map(answers.places.map((one) => [cellName(one), one]));
    let n = 0;
    for (const one of other.places) {
      const place = known.get(cellName(one));
      if (!place || one.answer === null) continue;
      place.answer = one.answer; place.time = one.time; n++;
    }
    if (other.person) answers.person = other.person;
    return n;
  }
  function firstOpen(from) {
    for (let k = 0; k < places.length; k++) {
      const i = (from + k) % places.length;
      if (answers.places[i].answer === null) return i;
    }
    return -1;
  }
  function answer(text) {
    answers.places[now].answer = text;
    answers.places[now].time = new Date().toISOString();
    past.push(now);
    keep();
    const next = firstOpen(now);
    if (next < 0) showAnswers(); else show(next);
  }
  function back() {
    const last = past.length ? past.pop() : now > 0 ? now - 1 : 0;
    show(last);
  }
  function save() {
    const link = document.createElement("a");
    const url = URL.createObjectURL(new Blob([JSON.stringify(answers, null, 1) + "\n"], { type: "application/json" }));
    link.href = url; link.download = about.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
    $("state").textContent = `Saved as ${about.file}. Then type: ${about.command}`;
  }

  // ---- data of a place: integers byte by byte, differences, deflated, base64
  async function unpack(name, bytes) {
    const node = $(name);
    if (!node) return new Uint32Array(0);
    const packed = Uint8Array.from(atob(node.textContent), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const raw = new Uint8Array(await new Response(stream).arrayBuffer());
    const n = raw.length / bytes, values = new Uint32Array(n), size = 2 ** (8 * bytes);
    let last = 0;
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < bytes; k++) last += raw[k * n + i] * 2 ** (8 * k);
      last %= size;
      values[i] = last;
    }
    return values;
  }
  // windows with range and brightness (0 = none, 1 to 255), and points x, y, z, height, brightness
  async function load(number) {
    const place = places[number], cells = await unpack(`cells-${number}`, 1), codes = await unpack(`points-${number}`, 2);
    let at = 0, from = 0;
    const points = { n: 0, x: [], y: [], z: [], bright: [], far: [], cell: [] };
    const windows = place.windows.map((one, level) => {
      const n = one.n[0] * one.n[1], range = cells.subarray(at, at + n);
      at += n;
      const bright = place.bright ? cells.subarray(at, at + n) : null;
      if (bright) at += n;
      if (codes.length) {
        const returns = [];
        for (let i = 0; i < n; i++) if (range[i]) returns.push(i);
        const m = returns.length, step = about.steps[level];
        for (let k = 0; k < m; k++) {
          const [x, y, z] = [0, 1, 2].map((axis) => codes[from + axis * m + k]);
          if (!x) continue;
          points.x.push((x - about.zero) * step); points.y.push((y - about.zero) * step); points.z.push((z - about.zero) * step);
          points.cell.push(level ? -1 : returns[k]);
          points.bright.push(bright ? bright[returns[k]] : 0);
          points.far.push(level);
          points.n++;
        }
        from += 3 * m;
      }
      return { n: one.n, steps: one.steps, flipped: one.flipped, range, bright, records: new Float64Array(0), metres: new Float64Array(0) };
    });
    // records and ranges of the near window, for labels by hand
    const [near] = windows, shots = await unpack(`shots-${number}`, 4), n = shots.length / 2;
    near.records = new Float64Array(near.range.length).fill(-1); near.metres = new Float64Array(near.range.length);
    for (let i = 0, k = 0; i < near.range.length; i++) if (near.range[i]) {
      near.records[i] = shots[k] - 1; near.metres[i] = shots[n + k] * about.range_step;
      k++;
    }
    return { place, windows, points };
  }

  // ---- drawing
  const pack = (r, g, b) => (255 << 24 | b << 16 | g << 8 | r) >>> 0;
  const ramp = about.ramp.map((one) => pack(...one));
  const gray = Array.from({ length: 256 }, (_, v) => pack(v, v, v));
  const dense = Math.min(window.devicePixelRatio || 1, 1.5), RAD = Math.PI / 180, FOV = 40 * RAD;
  const view = { azimuth: 0, up: 0, away: 1 };
  let data = null, painter = null, isBright = false, paper = 0, pick = "#c2007a", queued = false;
  function theme() {
    const style = getComputedStyle(document.documentElement), hex = style.getPropertyValue("--view").trim();
    const value = parseInt(hex.slice(1), 16);
    paper = pack(value >> 16, value >> 8 & 255, value & 255);
    pick = style.getPropertyValue("--pick").trim();
    redraw();
  }
  function fitCanvas(canvas) {
    const width = Math.max(1, Math.round(canvas.clientWidth * dense)), height = Math.max(1, Math.round(canvas.clientHeight * dense));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  }
  function ring(pen, x, y, radius) {
    for (const [colour, width] of [["#fff", 5], [pick, 2.5]]) {
      pen.strokeStyle = colour; pen.lineWidth = width * dense;
      pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.stroke();
    }
  }
  function drawImage(canvas, one) {
    fitCanvas(canvas);
    const [nLines, nColumns] = one.n, pen = canvas.getContext("2d"), sheet = document.createElement("canvas");
    sheet.width = nLines; sheet.height = nColumns;
    const sheetPen = sheet.getContext("2d"), pixels = sheetPen.createImageData(nLines, nColumns), out = new Uint32Array(pixels.data.buffer);
    const rowOf = (column) => one.flipped ? nColumns - 1 - column : column;
    for (let line = 0; line < nLines; line++) for (let column = 0; column < nColumns; column++) {
      const i = line * nColumns + column, range = one.range[i];
      const colour = !range ? paper : isBright && one.bright ? gray[one.bright[i]] : ramp[255 - range];
      out[rowOf(column) * nLines + line] = range && one.records.length ? painter.tint(colour, one.records[i]) : colour;
    }
    sheetPen.putImageData(pixels, 0, 0);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(sheet, 0, 0, canvas.width, canvas.height);
    const wide = canvas.width / nLines, tall = canvas.height / nColumns;
    const line = Math.floor(nLines / 2), row = rowOf(Math.floor(nColumns / 2));
    ring(pen, (line + 0.5) * wide, (row + 0.5) * tall, Math.max(8 * dense, Math.max(wide, tall)));
    if (one.records.length) painter.draw(pen);
  }
  let depths = new Float32Array(0), ids = new Int32Array(0);
  function drawCloud() {
    const canvas = $("cloud"), pen = canvas.getContext("2d");
    fitCanvas(canvas);
    const { width, height } = canvas, n = width * height, { points } = data;
    if (depths.length !== n) { depths = new Float32Array(n); ids = new Int32Array(n); }
    depths.fill(Infinity); ids.fill(-1);
    const a = view.azimuth * RAD, e = view.up * RAD, sa = Math.sin(a), ca = Math.cos(a), se = Math.sin(e), ce = Math.cos(e);
    const focal = height / 2 / Math.tan(FOV / 2), near = view.away * 0.05;
    const across = (x, y) => -ca * x + sa * y, along = (x, y, z) => -(sa * ce * x + ca * ce * y + se * z), down = (x, y, z) => sa * se * x + ca * se * y - ce * z;
    for (let q = 0; q < points.n; q++) {
      const x = points.x[q], y = points.y[q], z = points.z[q], depth = along(x, y, z) + view.away;
      if (depth < near) continue;
      const s = focal / depth, px = (across(x, y) * s + width / 2) | 0, py = (down(x, y, z) * s + height / 2) | 0;
      const size = Math.min(9, Math.max(1, Math.round((points.far[q] ? 0.045 : 0.02) * view.away * s * 0.25 * dense)));
      const x0 = Math.max(0, px - (size >> 1)), x1 = Math.min(width - 1, px + (size >> 1)), y0 = Math.max(0, py - (size >> 1)), y1 = Math.min(height - 1, py + (size >> 1));
      for (let j = y0; j <= y1; j++) for (let k = j * width + x0, end = j * width + x1; k <= end; k++) if (depth < depths[k]) { depths[k] = depth; ids[k] = q; }
    }
    const low = data.low, span = Math.max(data.high - low, 0.5), sheet = pen.createImageData(width, height), out = new Uint32Array(sheet.data.buffer);
    const asBright = isBright && data.place.bright;
    for (let k = 0; k < n; k++) {
      const q = ids[k];
      if (q < 0) { out[k] = paper; continue; }
      const plain = asBright ? gray[points.bright[q]] : ramp[Math.min(255, Math.max(0, Math.round(255 * (points.z[q] - low) / span)))];
      const colour = points.cell[q] < 0 ? plain : painter.tint(plain, data.windows[0].records[points.cell[q]]);
      // edges: darker where neighbours are in front (eye-dome lighting, Boucheny 2009)
      let deeper = 0;
      for (const other of [k - 1, k + 1, k - width, k + width, k - 2, k + 2, k - 2 * width, k + 2 * width])
        if (other >= 0 && other < n && depths[other] < depths[k]) deeper += Math.min(0.06, Math.log2(depths[k] / depths[other]));
      const light = Math.max(0.35, Math.exp(-4 * deeper));
      out[k] = pack((colour & 255) * light, (colour >> 8 & 255) * light, (colour >> 16 & 255) * light);
    }
    pen.putImageData(sheet, 0, 0);
    if (points.n) ring(pen, width / 2, height / 2, 9 * dense);
    $("cloud-hint").textContent = points.n ? `about ${2 * data.place.reach < 10 ? (2 * data.place.reach).toFixed(1) : Math.round(2 * data.place.reach)} m at first, colours by ${asBright ? "brightness" : "height"}` : "Nothing places the shots in space.";
  }
  function redraw() {
    if (queued) return;
    queued = true;
    requestAnimationFrame(() => {
      queued = false;
      if (!data) return;
      drawCloud();
      drawImage($("near"), data.windows[0]);
      drawImage($("wide"), data.windows[1]);
    });
  }
  function fit(up = data.place.up) { view.azimuth = data.place.azimuth; view.up = up; view.away = data.place.reach / Math.tan(FOV / 2) * 1.15; redraw(); }
  function turn(dx, dy) { view.azimuth = (view.azimuth + dx + 360) % 360; view.up = Math.max(-89, Math.min(90, view.up + dy)); redraw(); }
  function zoom(factor) { view.away = Math.max(0.2, Math.min(400, view.away / factor)); redraw(); }

  // ---- a place
  async function show(number) {
    now = number;
    const loaded = await load(number);
    if (now !== number) return;
    const heights = Float32Array.from(loaded.points.z).sort();
    loaded.low = heights.length ? heights[Math.floor(heights.length * 0.02)] : 0;
    loaded.high = heights.length ? heights[Math.floor(heights.length * 0.98)] : 1;
    data = loaded;
    spot[0] = Math.floor(picture.width / 2); spot[1] = Math.floor(picture.height / 2);
    const { place } = data, [scanner, line, column, record] = place.cell;
    $("facts").textContent = `line ${line}, column ${column}${scanner ? `, scanner ${scanner}` : ""}${record < 0 ? "" : `, record ${record}`}, range ${place.range.toFixed(2)} m`;
    $("bright").hidden = !place.bright;
    const steps = ([lines, columns]) => lines > 1 || columns > 1 ? `1 line of ${lines}, 1 column of ${columns}` : "every line and column";
    const colours = isBright && place.bright ? "brightness" : "range";
    $("near-hint").textContent = `${colours}, ${steps(place.windows[0].steps)}`;
    $("wide-hint").textContent = `${colours}, ${steps(place.windows[1].steps)}`;
    fit();
    showAnswers();
    document.body.dataset.place = String(number);
  }
  function showAnswers() {
    const n = answers.places.filter((one) => one.answer !== null).length, unsure = answers.places.filter((one) => one.answer === CANNOT_TELL).length;
    $("count").textContent = `Place ${now + 1} of ${places.length}`;
    $("progress").max = places.length; $("progress").value = n;
    $("state").textContent = n === places.length ? `All ${n} places are answered: save the answers.` : `${n} of ${places.length} answered${unsure ? `, ${unsure} cannot tell` : ""}.`;
    for (const button of $("classes").children) button.setAttribute("aria-pressed", String(button.dataset.answer === answers.places[now].answer));
    document.body.dataset.answered = String(n);
  }
  const choices = [...answers.classes.map((name, k) => [name, k < 9 ? String(k + 1) : "", about.colours[k]]), [OTHER, "O", null], [CANNOT_TELL, "0", null]];
  $("classes").append(...choices.map(([name, key, colour]) => {
    const button = document.createElement("button"), kbd = document.createElement("kbd"), chip = document.createElement("span");
    button.type = "button"; button.dataset.answer = name;
    kbd.textContent = key;
    button.append(kbd);
    if (colour) { chip.style.background = `rgb(${colour.join(",")})`; button.append(chip); }
    button.append(name === OTHER ? "none of these" : name);
    button.addEventListener("click", () => { answer(name); button.blur(); });
    return button;
  }));

  // ---- keys, pointers, files
  function bright() {
    if (!data.place.bright) return;
    isBright = !isBright;
    $("bright").setAttribute("aria-pressed", String(isBright));
    for (const id of ["near-hint", "wide-hint"]) $(id).textContent = $(id).textContent.replace(/^\w+/, isBright ? "brightness" : "range");
    redraw();
  }
  // ---- labels by hand, in the near window: its cells are records
  const near = $("near"), spot = [0, 0], rowOf = (y) => data.windows[0].flipped ? picture.height - 1 - y : y;
  const indexAt = (x, y) => x * picture.height + rowOf(y);
  const picture = {
    dense,
    get width() { return data ? data.windows[0].n[0] : 1; },
    get height() { return data ? data.windows[0].n[1] : 1; },
    cell: (x, y) => data.windows[0].records[indexAt(x, y)],
    range: (x, y) => data.windows[0].metres[indexAt(x, y)],
    view: () => ({ x: 0, y: 0, wide: near.width / picture.width, tall: near.height / picture.height }),
    cursor: () => spot,
    changed: () => redraw(),
    redraw: () => redraw(),
    switched: () => redraw(),
    pan() {},
    zoom() {},
    columns: ["record"],
    identify: (record) => record,
    find: (rows) => rows.map(({ record }) => (Number.isInteger(record) ? record : -1)),
  };
  painter = labelsByHand(about.paint, near, picture);
  near.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!step || !painter.isOn) return;
    spot[0] = Math.max(0, Math.min(picture.width - 1, spot[0] + step[0])); spot[1] = Math.max(0, Math.min(picture.height - 1, spot[1] + step[1]));
    event.preventDefault(); event.stopPropagation();
    redraw();
  });

  const next = () => { const open = firstOpen(now + 1); show(open < 0 ? (now + 1) % places.length : open); };
  const keys = {
    "?": () => answer(CANNOT_TELL), 0: () => answer(CANNOT_TELL), o: () => answer(OTHER), Backspace: back, n: next, b: bright, s: save,
    f: () => fit(), t: () => fit(90), "+": () => zoom(1.25), "=": () => zoom(1.25), "-": () => zoom(0.8),
    ArrowLeft: () => turn(-10, 0), ArrowRight: () => turn(10, 0), ArrowUp: () => turn(0, 8), ArrowDown: () => turn(0, -8),
  };
  addEventListener("keydown", (event) => {
    if (!data || event.ctrlKey || event.metaKey || event.altKey || event.target === $("person")) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key, name = answers.classes[Number(key) - 1];
    if (/^[1-9]$/.test(key)) { if (name) answer(name); } else if (keys[key]) keys[key](); else return;
    event.preventDefault();
  });
  $("back").addEventListener("click", back);
  $("next").addEventListener("click", next);
  $("bright").addEventListener("click", bright);
  $("save").addEventListener("click", save);
  for (const button of document.querySelectorAll("button[data-do]")) button.addEventListener("click", () => {
    ({ in: () => zoom(1.25), out: () => zoom(0.8), fit: () => fit(), top: () => fit(90) })[button.dataset.do]();
    button.blur();
  });
  $("person").addEventListener("input", () => { answers.person = $("person").value.trim(); keep(); });
  $("load").addEventListener("change", async (event) => {
    const [file] = event.target.files;
    event.target.value = "";
    if (!file) return;
    try {
      const n = takeOver(JSON.parse(await file.text()));
      $("problem").hidden = true;
      $("person").value = answers.person;
      keep();
      await show(Math.max(0, firstOpen(0)));
      $("state").textContent = `${n} answers loaded.`;
    } catch (error) { complain(`${file.name} cannot be loaded. ${error.message}`); }
  });
  const cloud = $("cloud"), fingers = new Map();
  cloud.addEventListener("pointerdown", (event) => { cloud.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.clientX, event.clientY]); });
  cloud.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId), here = [event.clientX, event.clientY];
    if (!before || !data) return;
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1], apart = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]);
      zoom(apart(here) / Math.max(1, apart(before)));
    } else turn((here[0] - before[0]) * 0.4, (here[1] - before[1]) * 0.4);
    fingers.set(event.pointerId, here);
  });
  for (const name of ["pointerup", "pointercancel"]) cloud.addEventListener(name, (event) => fingers.delete(event.pointerId));
  cloud.addEventListener("wheel", (event) => { event.preventDefault(); if (data) zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015))); }, { passive: false });

  try { const stored = localStorage.getItem(kept); if (stored) takeOver(JSON.parse(stored)); } catch { /* the page works without what was kept */ }
  $("person").value = answers.person;
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  new ResizeObserver(redraw).observe($("check"));
  theme();
  show(Math.max(0, firstOpen(0)));
})();
