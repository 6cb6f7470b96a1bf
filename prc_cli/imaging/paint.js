"use strict";
// Labels by hand on a range image: both pages have this script.
// A page gives its picture: `width` and `height` in cells, `cell(x, y)` (a whole number, -1 = no
// shot), `range(x, y)` in metres (0 = none), `view()` (cell at the upper left corner, pixels per
// cell), `dense` (pixels per CSS pixel), `cursor()`, `changed(cells, isFinished)`, `redraw()`,
// `pan(dx, dy)`, `zoom(factor, x, y)`, and for files `columns`, `identify(cell)`, `find(rows)`.

// the class of every painted cell, in pages, since most cells have none
class CellClasses {
  constructor() { this.pages = new Map(); this.number = -1; this.page = null; this.counts = new Array(256).fill(0); }
  turnTo(cell) {
    const number = Math.floor(cell / 4096);
    if (number === this.number) return;
    this.number = number;
    this.page = this.pages.get(number) || null;
  }
  get(cell) { this.turnTo(cell); return this.page ? this.page[cell % 4096] : 0; }
  set(cell, value) {
    this.turnTo(cell);
    if (!this.page) { this.page = new Uint8Array(4096); this.pages.set(this.number, this.page); }
    this.counts[this.page[cell % 4096]]--;
    this.counts[value]++;
    this.page[cell % 4096] = value;
  }
  *cells() {
    for (const number of [...this.pages.keys()].sort((a, b) => a - b)) {
      const page = this.pages.get(number);
      for (let i = 0; i < 4096; i++) if (page[i]) yield [number * 4096 + i, page[i]];
    }
  }
}

function labelsByHand(about, canvas, picture) {
  const $ = (id) => document.getElementById(id);
  const MOST_UNDONE = 2e7, KEEP_AFTER_MS = 250;
  const labels = new CellClasses(), kept = `prc-labels ${about.scan}`;
  const colours = [null, ...about.classes.map((one) => one.colour)];
  let tool = "look", last = "brush", value = 1, size = 24, tolerance = 0.1;
  let stroke = null, done = [], undone = [], corners = [], pointer = null, later = 0;
  const fingers = new Map();

  // ---- strokes: the cells that changed, each with its class before
  function put(cell, next = value) {
    const before = labels.get(cell);
    if (before === next) return;
    stroke.cells.push(cell); stroke.values.push(before);
    labels.set(cell, next);
  }
  function finish() {
    if (stroke && stroke.cells.length) {
      done.push(stroke);
      undone = [];
      let n = 0;
      done = done.reverse().filter((one) => (n += one.cells.length) <= MOST_UNDONE).reverse();
    }
    const cells = stroke ? stroke.cells : [];
    stroke = null;
    tell(cells);
  }
  function tell(cells) {
    picture.changed(cells, true);
    clearTimeout(later);
    later = setTimeout(keep, KEEP_AFTER_MS);
    count();
  }
  function swap(from, to) {
    const one = from.pop();
    if (!one) return;
    for (let k = one.cells.length - 1; k >= 0; k--) {
      const now = labels.get(one.cells[k]);
      labels.set(one.cells[k], one.values[k]);
      one.values[k] = now;
    }
    one.cells.reverse(); one.values.reverse();
    to.push(one);
    tell(one.cells);
  }
  const undo = () => (corners.length ? dropCorner() : swap(done, undone)), redo = () => swap(undone, done);
  function whole(act) { stroke = { cells: [], values: [] }; act(); finish(); }

  // ---- brush, polygon, flood
  const toCell = ([x, y]) => { const view = picture.view(); return [x / view.wide + view.x, y / view.tall + view.y]; };
  const toPixel = ([x, y]) => { const view = picture.view(); return [(x - view.x) * view.wide, (y - view.y) * view.tall]; };
  function putAt(x, y) {
    if (x < 0 || y < 0 || x >= picture.width || y >= picture.height) return;
    const cell = picture.cell(x, y);
    if (cell >= 0) put(cell);
  }
  // all cells with their middle near the line between two pixels, and the cell of the last one
  function brush(from, to) {
    const first = stroke.cells.length, view = picture.view(), reach = size / 2 * picture.dense;
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]], length = dx * dx + dy * dy;
    const [x0, y0] = toCell([Math.min(from[0], to[0]) - reach, Math.min(from[1], to[1]) - reach]);
    const [x1, y1] = toCell([Math.max(from[0], to[0]) + reach, Math.max(from[1], to[1]) + reach]);
    for (let x = Math.max(0, Math.floor(x0)); x <= Math.min(picture.width - 1, x1); x++) {
      const px = (x + 0.5 - view.x) * view.wide - from[0];
      for (let y = Math.max(0, Math.floor(y0)); y <= Math.min(picture.height - 1, y1); y++) {
        const py = (y + 0.5 - view.y) * view.tall - from[1];
        const along = length ? Math.max(0, Math.min(1, (px * dx + py * dy) / length)) : 0;
        if ((px - along * dx) ** 2 + (py - along * dy) ** 2 <= reach * reach) putAt(x, y);
      }
    }
    putAt(...toCell(to).map(Math.floor));
    picture.changed(stroke.cells.slice(first), false);
  }
  function addCorner(place) {
    const [x, y] = place, [firstX, firstY] = corners.length ? toPixel(corners[0]) : [NaN, NaN];
    if (corners.length > 2 && Math.hypot(x - firstX, y - firstY) < 12 * picture.dense) return closePolygon();
    corners.push(toCell(place));
    picture.redraw(); count();
  }
  function dropCorner() { corners.pop(); picture.redraw(); count(); }
  function closePolygon() {
    const around = corners;
    corners = [];
    if (around.length < 3) { picture.redraw(); return count(); }
    whole(() => {
      const across = around.map(([x]) => x), end = Math.min(picture.width - 1, Math.max(...across));
      for (let x = Math.max(0, Math.floor(Math.min(...across))); x <= end; x++) {
        const crossings = [];
        around.forEach(([ax, ay], k) => {
          const [bx, by] = around[(k + 1) % around.length], middle = x + 0.5;
          if ((ax <= middle) !== (bx <= middle)) crossings.push(ay + (middle - ax) / (bx - ax) * (by - ay));
        });
        crossings.sort((a, b) => a - b);
        for (let k = 0; k + 1 < crossings.length; k += 2)
          for (let y = Math.ceil(crossings[k] - 0.5); y <= crossings[k + 1] - 0.5; y++) putAt(x, y);
      }
    });
  }
  // neighbouring shots with like ranges; shots that were painted otherwise stop it
  function flood(place) {
    const [x0, y0] = toCell(place).map(Math.floor), { width, height } = picture;
    if (x0 < 0 || y0 < 0 || x0 >= width || y0 >= height || picture.cell(x0, y0) < 0) return;
    const start = labels.get(picture.cell(x0, y0)), seen = new Uint8Array(width * height), open = [x0 * height + y0];
    seen[open[0]] = 1;
    whole(() => {
      while (open.length) {
        const here = open.pop(), y = here % height, x = (here - y) / height, range = picture.range(x, y);
        put(picture.cell(x, y));
        const visit = (nx, ny) => {
          const there = nx * height + ny;
          if (nx < 0 || ny < 0 || nx >= width || ny >= height || seen[there]) return;
          const other = picture.range(nx, ny), cell = picture.cell(nx, ny);
          if (cell < 0 || !other || Math.abs(other - range) > tolerance || labels.get(cell) !== start) return;
          seen[there] = 1;
          open.push(there);
        };
        visit(x - 1, y); visit(x + 1, y); visit(x, y - 1); visit(x, y + 1);
      }
    });
  }

  // ---- pointers: one paints; two, or another button, move the picture
  const isPainting = () => tool !== "look";
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) * canvas.width / box.width, (event.clientY - box.top) * canvas.height / box.height];
  };
  function cancel() {
    if (!stroke) return;
    const isChange = stroke.cells.length > 0;
    finish();
    if (isChange) swap(done, []); // what the first of two fingers painted
  }
  const actions = {
    pointerdown(event) {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      const place = placeOf(event);
      fingers.set(event.pointerId, place);
      pointer = place;
      if (fingers.size > 1) cancel();
      else if (event.button === 0 && tool === "brush") { stroke = { cells: [], values: [] }; brush(place, place); }
    },
    pointermove(event) {
      const place = placeOf(event), before = fingers.get(event.pointerId);
      pointer = event.pointerType === "touch" && !before ? null : place;
      if (!before) return picture.redraw();
      if (fingers.size > 1 || (event.buttons & 6)) {
        picture.pan((place[0] - before[0]) / fingers.size, (place[1] - before[1]) / fingers.size);
        const other = [...fingers].find(([id]) => id !== event.pointerId);
        const apart = (one) => Math.max(1, Math.hypot(one[0] - other[1][0], one[1] - other[1][1]));
        if (other) { picture.zoom(apart(place) / apart(before), ...place); fingers.moved = true; }
      } else if (stroke) brush(before, place);
      fingers.set(event.pointerId, place);
      picture.redraw();
    },
    pointerup(event) {
      const place = placeOf(event);
      fingers.delete(event.pointerId);
      if (stroke) finish();
      else if (!fingers.moved && event.button === 0 && tool === "polygon") addCorner(place);
      else if (!fingers.moved && event.button === 0 && tool === "flood") flood(place);
      if (!fingers.size) fingers.moved = false;
      if (event.pointerType === "touch") pointer = null;
      picture.redraw();
    },
    pointercancel(event) { fingers.delete(event.pointerId); fingers.moved = false; cancel(); },
    pointerleave() { pointer = null; picture.redraw(); },
  };
  for (const [name, act] of Object.entries(actions)) canvas.addEventListener(name, (event) => {
    if (!isPainting()) return;
    event.stopImmediatePropagation();
    act(event);
  }, true);
  canvas.addEventListener("contextmenu", (event) => { if (isPainting()) event.preventDefault(); });

  // ---- keys
  function atCursor() {
    const cell = picture.cursor();
    if (!cell) return;
    const place = toPixel(cell.map((one) => one + 0.5));
    if (tool === "polygon") addCorner(place);
    else if (tool === "flood") flood(place);
    else whole(() => brush(place, place));
  }
  const keys = {
    b: () => choose("brush"), g: () => choose("polygon"), f: () => choose("flood"), p: () => choose("look"), e: () => pick(0),
    z: undo, y: redo, s: save, "[": () => resize(1 / 1.3), "]": () => resize(1.3), Backspace: undo, " ": atCursor,
    Enter: () => (corners.length > 2 ? closePolygon() : atCursor()),
    Escape: () => { if (corners.length) { corners = []; picture.redraw(); count(); } else choose("look"); },
  };
  addEventListener("keydown", (event) => {
    const isTyped = event.target.matches && event.target.matches("input[type=text], select"), isControl = event.ctrlKey || event.metaKey;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (isTyped || event.altKey || (isControl && !(isPainting() && "zy".includes(key)))) return;
    const isButton = event.target.matches && event.target.matches("button, summary, input") && [" ", "Enter"].includes(key);
    if (!isPainting() && key === "p") choose(last);
    else if (!isPainting() || isButton) return;
    else if (/^[0-9]$/.test(key)) { if ((Number(key) || 10) <= about.classes.length) pick(Number(key) || 10); }
    else if (key === "z" && event.shiftKey) redo();
    else if (keys[key]) keys[key]();
    else return;
    event.preventDefault();
    event.stopImmediatePropagation();
  }, true);

  // ---- the panel
  function choose(name) {
    tool = name;
    if (name !== "look") last = name;
    corners = [];
    document.body.classList.toggle("painting", isPainting());
    for (const button of $("paint-tools").children) button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
    $("paint-size-row").hidden = tool !== "brush";
    $("paint-tolerance-row").hidden = tool !== "flood";
    picture.switched(isPainting());
    picture.redraw(); count();
  }
  function pick(next) {
    if (next > about.classes.length) return;
    value = next;
    for (const button of $("paint-classes").children) button.setAttribute("aria-pressed", String(Number(button.dataset.value) === value));
    picture.redraw();
  }
  function resize(factor) {
    if (tool === "flood") $("paint-tolerance").value = Number($("paint-tolerance").value) + Math.log10(factor);
    else $("paint-size").value = Math.round(size * factor + (factor > 1 ? 1 : -1));
    measure();
  }
  function measure() {
    size = Number($("paint-size").value);
    tolerance = 10 ** Number($("paint-tolerance").value);
    $("paint-size-text").textContent = `${size} px`;
    $("paint-tolerance-text").textContent = `${tolerance < 0.1 ? tolerance.toFixed(3) : tolerance.toFixed(2)} m`;
    picture.redraw();
  }
  function count(text) {
    const counts = labels.counts, rows = about.classes.map((one, k) => [one.name, counts[k + 1]]).filter(([, n]) => n > 0);
    const n = rows.reduce((sum, [, each]) => sum + each, 0), thousands = (each) => each.toLocaleString("en");
    const names = rows.map(([name, each]) => `${name} ${thousands(each)}`).join(", ");
    const open = corners.length ? `${corners.length} corners: Enter or the first corner closes. ` : "";
    $("paint-state").textContent = open + (text || (n ? `${thousands(n)} shots painted: ${names}.` : "Nothing is painted."));
    $("paint-undo").disabled = !done.length && !corners.length; $("paint-redo").disabled = !undone.length;
    $("paint-close").hidden = corners.length < 3;
    document.body.dataset.painted = String(n);
  }
  function button(text, name, data, act) {
    const node = document.createElement("button"), kbd = document.createElement("kbd"), chip = document.createElement("span");
    node.type = "button";
    Object.assign(node.dataset, data);
    kbd.textContent = text;
    node.append(kbd);
    if (colours[data.value]) { chip.style.background = `rgb(${colours[data.value].join(",")})`; node.append(chip); }
    node.append(name);
    node.addEventListener("click", () => { act(); node.blur(); });
    return node;
  }
  $("paint-classes").append(
    ...about.classes.map((one, k) => button(k < 10 ? String((k + 1) % 10) : "", one.name, { value: k + 1 }, () => { pick(k + 1); if (!isPainting()) choose(last); })),
    button("E", "eraser", { value: 0 }, () => { pick(0); if (!isPainting()) choose(last); }),
  );
  for (const node of $("paint-tools").children) node.addEventListener("click", () => { choose(node.dataset.tool); node.blur(); });
  for (const [name, act] of Object.entries({ undo, redo, close: closePolygon, save })) $(`paint-${name}`).addEventListener("click", () => { act(); $(`paint-${name}`).blur(); });
  for (const name of ["paint-size", "paint-tolerance"]) $(name).addEventListener("input", measure);
  $("paint-load").addEventListener("change", async (event) => {
    const [file] = event.target.files;
    event.target.value = "";
    if (!file) return;
    try { count(`${load(await file.text()).toLocaleString("en")} labels loaded from ${file.name}.`); } catch (error) { count(`${file.name} cannot be loaded. ${error.message}`); }
  });

  // ---- files, and what the browser keeps
  function save() {
    const parts = [`# labels by hand: ${about.name}${about.records === null ? "" : `, ${about.records} records`}\n`, [...picture.columns, "class", "class_name"].join(",") + "\n"];
    let rows = [];
    for (const [cell, number] of labels.cells()) {
      const { code, name } = about.classes[number - 1];
      rows.push(`${picture.identify(cell)},${code},${name}\n`);
      if (rows.length > 10000) { parts.push(rows.join("")); rows = []; }
    }
    const link = document.createElement("a"), url = URL.createObjectURL(new Blob([...parts, rows.join("")], { type: "text/csv" }));
    link.href = url; link.download = about.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
    count(`Saved as ${about.file}. Then type: ${about.command}`);
  }
  function load(text) {
    const lines = text.split(/\r?\n/).filter((line) => line), head = /^# labels by hand: (.*?)(?:, (\d+) records)?$/.exec(lines[0]);
    if (head && head[2] && about.records !== null && Number(head[2]) !== about.records) throw new Error(`Its labels are about another file, ${head[1]}.`);
    const [names, ...rows] = lines.filter((line) => !line.startsWith("#")).map((line) => line.split(","));
    const column = (name) => names.indexOf(name), codes = new Map(about.classes.map((one, k) => [String(one.code), k + 1]));
    if (column("class") < 0) throw new Error("It has no column named class.");
    const cells = picture.find(rows.map((row) => ({ record: Number(row[column("record")] || NaN), line: Number(row[column("scan_line")] || NaN), column: Number(row[column("column")] || NaN) })));
    let n = 0;
    whole(() => cells.forEach((cell, k) => {
      const number = codes.get(rows[k][column("class")]);
      if (cell >= 0 && number) { put(cell, number); n++; }
    }));
    if (rows.length && !n) throw new Error("None of its labels is about a shot of this page.");
    return n;
  }
  // runs of cells with one class: distance from the run before, length, class
  function keep() {
    const runs = [];
    let from = 0, run = null;
    const close = () => { if (run) { runs.push(`${run.first - from} ${run.n} ${run.number}`); from = run.first + run.n; } };
    for (const [cell, number] of labels.cells()) {
      if (run && cell === run.first + run.n && number === run.number) { run.n++; continue; }
      close();
      run = { first: cell, n: 1, number };
    }
    close();
    try { localStorage.setItem(kept, runs.join(",")); } catch { count("The browser does not keep your labels: save them before you close the page."); }
  }
  function restore() {
    let from = 0;
    for (const text of (localStorage.getItem(kept) || "").split(",").filter(Boolean)) {
      const [gap, n, number] = text.split(" ").map(Number);
      from += gap;
      if (number <= about.classes.length) for (let k = 0; k < n; k++) labels.set(from + k, number);
      from += n;
    }
  }
  addEventListener("pagehide", keep);

  // ---- what the page draws
  function tint(colour, cell) {
    const number = cell < 0 ? 0 : labels.get(cell);
    if (!number) return colour;
    const grey = 0.3 * (colour & 255) + 0.59 * (colour >> 8 & 255) + 0.11 * (colour >> 16 & 255), [r, g, b] = colours[number].map((one) => 0.75 * one + 0.25 * grey);
    return (255 << 24 | b << 16 | g << 8 | r) >>> 0;
  }
  function draw(pen) {
    if (!isPainting()) return;
    const colour = value ? `rgb(${colours[value].join(",")})` : "#fff", outline = (width, style) => { pen.lineWidth = width * picture.dense; pen.strokeStyle = style; pen.stroke(); };
    const cursor = picture.cursor(), place = pointer || (cursor && document.activeElement === canvas ? toPixel(cursor.map((one) => one + 0.5)) : null);
    pen.beginPath();
    corners.forEach((corner, k) => pen[k ? "lineTo" : "moveTo"](...toPixel(corner)));
    if (corners.length && place) pen.lineTo(...place);
    if (corners.length > 1) pen.closePath();
    if (place) { const reach = (tool === "brush" ? size / 2 : 4) * picture.dense; pen.moveTo(place[0] + reach, place[1]); pen.arc(...place, reach, 0, 2 * Math.PI); }
    for (const corner of corners) { const [x, y] = toPixel(corner); pen.rect(x - 3, y - 3, 6, 6); }
    outline(4, "#0009"); outline(2, colour);
  }
  try { restore(); } catch { /* the page works without what was kept */ }
  measure(); pick(1); choose("look");
  return { tint, draw, get isBusy() { return stroke !== null; }, get isOn() { return isPainting(); } };
}
