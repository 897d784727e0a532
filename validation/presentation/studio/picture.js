// The picture of a task: regions and starts that can be drawn, moved and resized, and episodes above them.
// Whatever is moved is sent as a change of the text; the text is the truth, and the picture follows it.

const NS = "http://www.w3.org/2000/svg", WIDE = 640, NARROW = 400, LEFT = 46, TOP = 10, RIGHT = 12, BOTTOM = 34;
// Height by width of maps whose axes have no scale in common, and of tracks over time; and what no picture exceeds.
const FLATTEST = 0.4, TRACK = 0.46, TALLEST = {[WIDE]: 1, [NARROW]: 1.2};
const CORNERS = 6, WORDS = {reached: "goal", avoided: "rock", kept: "safe", free: "region"};

// Corners of an arrow along the first axis, as in frames and reports.
const ARROW = [[1, 0], [-0.7, 0.6], [-0.4, 0], [-0.7, -0.6]];

// How many units a picture is wide: fewer where it is shown small, so that its words can be read.
let WIDTH = WIDE;

/** Corners of an arrow at a place, so many units from its middle to its tip, that points to an angle of the task. */
function pointing(x, y, size, angle) {
  const [c, s] = [size * Math.cos(angle), size * Math.sin(angle)];
  return ARROW.map(([a, b]) => (x + c * a - s * b).toFixed(1) + "," + (y - s * a - c * b).toFixed(1)).join(" ");
}

const copy = value => JSON.parse(JSON.stringify(value));
const at = id => document.getElementById(id);

function make(parent, name, set, text) {
  const e = document.createElementNS(NS, name);
  for (const key in set) e.setAttribute(key, set[key]);
  if (text !== undefined) e.textContent = text;
  parent.append(e);
  return e;
}

/** Round numbers between two ends, about as many as are asked for. */
function ticks(low, high, most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(k => k * power).find(s => s >= raw * 0.999), out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) out.push(+(k * step).toPrecision(10));
  return out;
}

/** One panel: its axes, and points of the pointer as numbers of the task. */
class Axes {
  constructor(panel, horizon) {
    Object.assign(this, {panel, horizon});
    this.low = panel.map ? panel.low : [0, panel.low[0]];
    this.high = panel.map ? panel.high : [horizon, panel.high[0]];
    const span = [0, 1].map(k => this.high[k] - this.low[k]), inner = WIDTH - LEFT - RIGHT;
    const free = panel.map ? Math.min(1, Math.max(FLATTEST, span[1] / span[0])) : TRACK, ratio = panel.proportion || free;
    // A map that is taller than wide is as narrow as its scale asks for, in the middle of its card.
    this.share = Math.min(1, TALLEST[WIDTH] / ratio);
    this.width = inner * this.share;
    this.left = LEFT + (inner - this.width) / 2;
    this.tall = this.width * ratio;
    this.height = this.tall + TOP + BOTTOM;
    // Moves are by numbers that are short to write.
    this.steps = span.map(s => 10 ** Math.ceil(Math.log10(s / 400)));
  }
  x(v) { return this.left + (v - this.low[0]) / (this.high[0] - this.low[0]) * this.width; }
  y(v) { return TOP + this.tall - (v - this.low[1]) / (this.high[1] - this.low[1]) * this.tall; }
  point(svg, event) {
    const r = svg.getBoundingClientRect(), px = (event.clientX - r.left) / r.width * WIDTH;
    const py = (event.clientY - r.top) / r.height * this.height;
    const inside = [(px - this.left) / this.width, 1 - (py - TOP) / this.tall].map(v => Math.max(0, Math.min(1, v)));
    return inside.map((v, k) => this.low[k] + v * (this.high[k] - this.low[k]));
  }
  round(v, k) {
    const step = this.steps[k];
    return +(Math.round(v / step) * step).toFixed(Math.max(0, -Math.round(Math.log10(step))));
  }
}

export class Picture {
  constructor(edit, redraw) {
    Object.assign(this, {edit, redraw, tool: "move", chosen: "", held: null, views: [], seen: null, key: "", maps: [], of: ""});
    document.querySelectorAll("[data-tool]").forEach(b => { b.onclick = () => this.take(b.dataset.tool); });
    at("remove").onclick = () => this.remove(this.chosen);
    addEventListener("pointermove", event => this.move(event));
    addEventListener("pointerup", event => this.drop(event));
    addEventListener("pointercancel", () => this.drop(null));
    addEventListener("resize", () => { if (this.picture && !this.held) this.draw(); });
  }

  /** Takes a tool: what the next drag makes. */
  take(tool) {
    this.tool = tool;
    document.querySelectorAll("[data-tool]").forEach(b => b.setAttribute("aria-pressed", b.dataset.tool === tool));
    at("panels").classList.toggle("drawing", tool !== "move");
    at("hint").textContent = tool === "move" ? "" : "drag over the picture";
  }

  /** Shows what the server saw in the text. */
  show(seen, current, revision) {
    at("panels").classList.toggle("faded", Boolean(seen.faded));
    if (!seen.picture) { at("panels").replaceChildren(); this.views = []; this.key = ""; return; }
    if (this.held || this.waits > revision || (this.waits && !current)) return;  // what is held is newer
    this.waits = 0;
    const key = JSON.stringify([seen.picture, seen.formula]);
    if (key === this.key) return;
    Object.assign(this, {key, seen, picture: copy(seen.picture)});
    this.offer();
    this.draw();
  }

  /** Offers the agents for whom regions can be drawn. */
  offer() {
    const names = [...new Set(this.picture.panels.flatMap(p => p.new.map(n => n.agent)))], pick = at("agent");
    at("whose").hidden = names.length < 2;
    if ([...pick.options].map(o => o.value).join() !== names.join())
      pick.replaceChildren(...names.map(name => new Option(name, name)));
  }

  /** Takes what is certified from other starts; it says nothing of a text in which more than starts was moved. */
  take_maps(maps, number, old) {
    const of = number + "/" + Boolean(maps);
    if (of !== this.of) { this.of = of; this.maps = maps || []; this.shifted = false; }
    else if (old && !this.held && !this.shifted) this.maps = [];
  }

  /** Draws below a start that is held what is certified from elsewhere, and what its colours say. */
  map(view, p) {
    const {axes, inside, above} = view, held = this.held, map = (this.maps[p] || []).find(m => m.color === held.thing.color);
    if (!map) return;
    const [nx, ny] = map.shape, step = map.points.map(x => x[1] - x[0]), shade = v => "fill-opacity:" + (0.06 + 0.9 * v).toFixed(3);
    map.shades.forEach((v, k) => {
      if (v < 0) return;
      const [x, y] = [map.points[0][Math.floor(k / ny)] - step[0] / 2, map.points[1][k % ny] + step[1] / 2];
      make(inside, "rect", {class: "cell", style: shade(v), x: axes.x(x), y: axes.y(y),
        width: axes.x(x + step[0]) - axes.x(x) + 0.4, height: axes.y(y - step[1]) - axes.y(y) + 0.4});
    });
    const long = 170, left = axes.left + 12, top = TOP + 26;
    make(above, "rect", {class: "paper", x: left - 8, y: TOP + 4, width: long + 16, height: 50});
    for (let k = 0; k < 24; k++)
      make(above, "rect", {class: "cell", style: shade((k + 0.5) / 24), x: left + k * long / 24, y: top, width: long / 24 + 0.3, height: 9});
    for (const [name, v] of map.ticks)
      make(above, "text", {class: "tick " + (v > 0.85 ? "end" : "middle"), x: left + v * long, y: top + 22}, name);
    const place = held.thing.low.map((v, n) => (v + held.thing.high[n]) / 2);
    const [i, j] = map.points.map((x, n) => x.reduce((best, v, k) => Math.abs(v - place[n]) < Math.abs(x[best] - place[n]) ? k : best, 0));
    const shown = map.shown[i * ny + j];
    make(above, "text", {x: left, y: TOP + 19}, shown ? "from here P ≥ " + shown : "from here nothing is known");
  }

  roleOf(panel, name) {
    const found = panel.regions.find(r => r.name === name);
    return found ? found.role : "free";
  }

  draw() {
    const focus = document.activeElement && document.activeElement.dataset && document.activeElement.dataset.key;
    WIDTH = this.picture.panels.length > 1 || innerWidth < 700 ? NARROW : WIDE;
    const figures = this.picture.panels.map((panel, p) => this.panel(panel, p));
    at("panels").replaceChildren(...figures);
    at("remove").disabled = !this.picture.panels.some(p => p.shapes.some(s => s.id === this.chosen && !s.part));
    if (focus) { const again = at("panels").querySelector('[data-key="' + CSS.escape(focus) + '"]'); if (again) again.focus(); }
    this.redraw();
  }

  panel(panel, p) {
    const axes = new Axes(panel, this.picture.horizon), figure = document.createElement("figure");
    const svg = make(figure, "svg", {viewBox: "0 0 " + WIDTH + " " + axes.height.toFixed(1), "data-panel": p});
    // A picture is never so tall that what is certified falls off the screen.
    svg.style.maxWidth = "calc((100vh - 400px) * " + (WIDTH / axes.height).toFixed(3) + ")";
    const clip = make(make(svg, "defs", {}), "clipPath", {id: "frame" + p});
    const frame = {x: axes.left, y: TOP, width: axes.width, height: axes.tall};
    make(clip, "rect", frame);
    make(svg, "rect", {class: "paper", ...frame}).addEventListener("pointerdown", event => this.begin(event, p));
    this.frame(svg, panel, axes);
    const view = {panel, axes, svg};
    view.inside = make(svg, "g", {"clip-path": "url(#frame" + p + ")"});
    view.names = make(svg, "g", {});
    view.ways = make(svg, "g", {"clip-path": "url(#frame" + p + ")"});
    view.above = make(svg, "g", {});
    this.views[p] = view;
    this.views.length = this.picture.panels.length;
    this.shapes(view, p);
    return figure;
  }

  frame(svg, panel, axes) {
    const bottom = TOP + axes.tall;
    for (const v of ticks(axes.low[0], axes.high[0], Math.max(2, 8 * axes.share))) {
      make(svg, "line", {class: "grid", x1: axes.x(v), x2: axes.x(v), y1: TOP, y2: bottom, "pointer-events": "none"});
      make(svg, "text", {class: "tick middle", x: axes.x(v), y: bottom + 14}, v);
    }
    for (const v of ticks(axes.low[1], axes.high[1], 7)) {
      make(svg, "line", {class: "grid", x1: axes.left, x2: axes.left + axes.width, y1: axes.y(v), y2: axes.y(v), "pointer-events": "none"});
      make(svg, "text", {class: "tick end", x: axes.left - 5, y: axes.y(v) + 4}, v);
    }
    const names = panel.map ? panel.names : ["time", panel.names[0]];
    make(svg, "text", {class: "name middle", x: axes.left + axes.width / 2, y: bottom + 29}, names[0]);
    const x = axes.left - LEFT + 11, y = TOP + axes.tall / 2;
    // A short name stands upright: a turned z would be an N.
    const turned = names[1].length > 3 ? {transform: "rotate(-90 " + x + " " + y + ")"} : {};
    make(svg, "text", {class: "name middle", ...turned, x, y}, names[1]);
  }

  /** Draws regions, starts and knobs of one panel anew. */
  shapes(view, p) {
    const {panel, axes, inside, names, above} = view, moved = new Set(panel.shapes.filter(s => !s.part).map(s => s.name));
    for (const g of [inside, names, above]) g.replaceChildren();
    if (this.held && this.held.part === "start" && this.held.p === p) this.map(view, p);
    const trace = points => "M" + points.map(q => axes.x(q[0]).toFixed(1) + " " + axes.y(q[1]).toFixed(1)).join("L") + "Z";
    const title = (x, y, name) => make(names, "text", {class: "shape-name", x: Math.max(axes.left + 4, x + 5), y: Math.max(TOP + 15, y + 16)}, name);
    for (const r of panel.regions.filter(r => !moved.has(r.name))) {
      const look = {class: "still r-" + r.role};
      if (panel.map) {
        make(inside, "path", {...look, d: r.fills.map(trace).join(""), style: "stroke:none"});
        make(inside, "path", {...look, d: r.edges.map(trace).join(""), style: "fill:none"});
        title(axes.x(r.low[0]), axes.y(r.high[1]), r.name);
      } else {
        const from = r.time === null ? 0 : Math.max(0, r.time - 0.5), to = r.time === null ? axes.horizon : r.time + 0.5;
        const corners = [[from, r.low[0]], [to, r.low[0]], [to, r.high[0]], [from, r.high[0]]];
        make(inside, "path", {...look, d: trace(corners)});
        if (!r.time) title(axes.x(from), axes.y(r.high[0]), r.name);
      }
    }
    // Large regions lie below small ones, so that each can be taken.
    for (const s of [...panel.shapes].sort((a, b) => this.size(b, axes) - this.size(a, axes))) this.shape(view, p, s, trace, title);
    panel.starts.forEach((s, k) => this.start(view, p, s, k));
  }

  /** Corners of the box of a shape on a panel: what it does not limit is as long as the axis. */
  ends(s, axes) {
    const on = axes.panel.map ? s.axes : [null, ...s.axes], low = [...axes.low], high = [...axes.high];
    if (s.kind === "disc") return [s.centre.map(v => v - s.radius), s.centre.map(v => v + s.radius)].map(v => on.map(k => v[k]));
    if (s.kind === "halfspace" || s.kind === "cone") return [low, high];
    if (s.kind === "polygon") return [Math.min, Math.max].map(f => on.map(k => f(...s.corners.map(c => c[k]))));
    on.forEach((k, j) => { if (k !== null) { low[j] = s.low[k]; high[j] = s.high[k]; } });
    return [low, high];
  }

  size(s, axes) {
    const [low, high] = this.ends(s, axes);
    return (high[0] - low[0]) * (high[1] - low[1]);
  }

  shape(view, p, s, trace, title) {
    const {axes, inside, above, panel} = view, chosen = s.id === this.chosen, [low, high] = this.ends(s, axes);
    const look = "body r-" + this.roleOf(panel, s.name) + (chosen ? " chosen" : "") + (s.part ? " part" : "") + (s.at.includes("complement") ? " hole" : "");
    const set = {class: look, tabindex: 0, role: "button", "data-key": p + "/" + s.id,
      "aria-label": "region " + s.name + (s.part ? ", a part of it" : "")};
    let corner = [low[0], high[1]];
    let body;
    if (s.kind === "disc") {
      const c = s.axes.map(k => s.centre[k]);
      body = make(inside, "ellipse", {...set, cx: axes.x(c[0]), cy: axes.y(c[1]),
        rx: axes.x(c[0] + s.radius) - axes.x(c[0]), ry: axes.y(c[1]) - axes.y(c[1] + s.radius)});
    } else {
      const corners = s.kind === "polygon" ? s.corners.map(c => s.axes.map(k => c[k])) :
        s.kind === "halfspace" ? this.half(s, axes).corners : s.kind === "cone" ? this.rays(s, axes) :
        [low, [high[0], low[1]], high, [low[0], high[1]]];
      if (s.kind === "cone") corner = corners[0];
      if (s.kind === "halfspace" && corners.length) corner = [Math.min(...corners.map(c => c[0])), Math.max(...corners.map(c => c[1]))];
      body = make(inside, "path", {...set, d: corners.length ? trace(corners) : ""});
    }
    body.addEventListener("pointerdown", event => this.tool === "move" ? this.hold(event, p, s, "all") : this.begin(event, p));
    body.addEventListener("keydown", event => this.key_(event, p, s));
    body.addEventListener("focus", () => this.choose(s.id));
    if (!s.part) title(axes.x(corner[0]), axes.y(corner[1]), s.name);
    if (chosen) for (const knob of this.knobs(s, axes)) {
      const dot = make(above, "circle", {class: "knob" + (knob.middle ? " middle" : ""), r: knob.middle ? 5 : 6.5,
        cx: axes.x(knob.at[0]), cy: axes.y(knob.at[1]), "data-knob": knob.part.join("/")});
      dot.addEventListener("pointerdown", event => this.hold(event, p, s, knob.part));
      if (s.kind === "polygon" && !knob.middle) dot.addEventListener("dblclick", () => this.cut(p, s, knob.part[1]));
    }
  }

  /** What a half-space has of a panel: its corners, and both ends of its edge. */
  half(s, axes) {
    const n = s.axes.map(k => s.normal[k]), over = q => n[0] * q[0] + n[1] * q[1] - s.offset;
    const frame = [axes.low, [axes.high[0], axes.low[1]], axes.high, [axes.low[0], axes.high[1]]], corners = [], edge = [];
    frame.forEach((a, k) => {
      const b = frame[(k + 1) % 4], u = over(a), v = over(b);
      if (u <= 0) corners.push(a);
      if (u <= 0 === v > 0) {
        const cut = [0, 1].map(j => a[j] + (b[j] - a[j]) * u / (u - v));
        corners.push(cut);
        edge.push(cut);
      }
    });
    return {corners, edge};
  }

  /** The tip of a cone, and points on its rays beyond the panel. */
  rays(s, axes) {
    const tip = s.axes.map(k => s.tip[k]), far = 4 * Math.max(...[0, 1].map(k => axes.high[k] - axes.low[k]));
    return [tip, ...[-1, 0, 1].map(side => this.along(s, side, far))];
  }

  /** A point at a distance from the tip of a cone: on its axis, or on the ray to one side of it. */
  along(s, side, far) {
    const tip = s.axes.map(k => s.tip[k]), axis = s.axes.map(k => s.axis[k]);
    const angle = Math.atan2(axis[1], axis[0]) + side * s.angle / 2;
    return [tip[0] + far * Math.cos(angle), tip[1] + far * Math.sin(angle)];
  }

  /** What resizes a shape: where, and which part of it. */
  knobs(s, axes) {
    if (s.kind === "halfspace") return this.half(s, axes).edge.map((place, k) => ({at: place, part: ["turn", k]}));
    if (s.kind === "cone") {
      const near = 0.25 * Math.min(...[0, 1].map(k => axes.high[k] - axes.low[k]));
      return [["axis", 0], ["angle", 1], ["angle", -1]].map(([what, side]) => ({at: this.along(s, side, near), part: [what, side]}));
    }
    const [low, high] = this.ends(s, axes), middle = [0, 1].map(k => (low[k] + high[k]) / 2);
    if (s.kind === "disc") return [[high[0], middle[1]], [low[0], middle[1]], [middle[0], high[1]], [middle[0], low[1]]]
      .map((place, k) => ({at: place, part: ["radius", k]}));
    if (s.kind === "polygon") {
      const c = s.corners.map(q => s.axes.map(k => q[k]));
      const between = c.map((q, k) => ({middle: true, part: ["between", k],
        at: [0, 1].map(j => (q[j] + c[(k + 1) % c.length][j]) / 2)}));
      return [...between, ...c.map((q, k) => ({at: q, part: ["corner", k]}))];
    }
    const on = axes.panel.map ? s.axes : [null, ...s.axes], out = [];
    for (const i of on[0] === null ? [0] : [-1, 0, 1]) for (const j of on[1] === null ? [0] : [-1, 0, 1])
      if (i || j) out.push({part: ["side", i, j], at: [i, j].map((e, k) => e < 0 ? low[k] : e > 0 ? high[k] : middle[k])});
    return out;
  }

  start(view, p, s, k) {
    const {axes, above} = view, map = axes.panel.map, low = map ? s.low : [0, s.low[0]], high = map ? s.high : [0, s.high[0]];
    const set = {class: "agent" + s.color, tabindex: 0, role: "button", "aria-label": "start of " + s.agent, "data-key": p + "/start" + k};
    const x = axes.x((low[0] + high[0]) / 2), y = axes.y((low[1] + high[1]) / 2);
    if (low.some((v, j) => v < high[j])) {
      const a = [axes.x(low[0]), axes.y(high[1])], b = [axes.x(high[0]), axes.y(low[1])];
      make(above, "rect", {class: "area agent" + s.color, x: a[0], y: a[1], width: Math.max(4, b[0] - a[0]), height: Math.max(4, b[1] - a[1])})
        .style.fill = "currentColor";
    }
    const dot = s.heading === null ? make(above, "circle", {...set, cx: x, cy: y, r: 8}) :
      make(above, "polygon", {...set, points: pointing(x, y, 14, s.heading)});
    dot.classList.add("start");
    make(dot, "title", {}, "start of " + s.agent);
    dot.addEventListener("pointerdown", event => this.hold(event, p, s, "start"));
    dot.addEventListener("keydown", event => {
      const by = this.arrow(event, axes);
      if (by) { this.shift(s, axes, by); this.send(this.startSets(s)); this.draw(); }
    });
  }

  choose(name) {
    if (this.chosen === name) return;
    this.chosen = name;
    if (!this.held) this.draw();
  }

  // Holding, moving, letting go.

  hold(event, p, thing, part) {
    event.preventDefault();
    event.stopPropagation();
    const {axes, svg} = this.views[p];
    if (part !== "start") this.chosen = thing.id;
    const from = axes.point(svg, event);
    this.held = {p, part, thing, from, first: copy(thing), name: thing.name, moved: false};
    if (part[0] === "between") this.between(thing, part[1]);
    this.draw();
    const key = p + "/" + (part === "start" ? "" : thing.id), body = at("panels").querySelector('[data-key="' + CSS.escape(key) + '"]');
    if (body) body.focus({preventScroll: true});
  }

  /** Begins to draw a region, or lets go of the one that was chosen. */
  begin(event, p) {
    if (this.tool === "move") { this.chosen = ""; this.draw(); return; }
    event.preventDefault();
    const {axes, svg, above} = this.views[p], from = axes.point(svg, event);
    const ghost = make(above, this.tool === "disc" ? "ellipse" : "path", {class: "ghost"});
    this.held = {p, part: "new", from, to: from, ghost};
  }

  move(event) {
    const held = this.held;
    if (!held) return;
    const {axes, svg} = this.views[held.p], to = axes.point(svg, event);
    if (held.part === "new") { held.to = to; this.sketch(held, axes); return; }
    const by = to.map((v, k) => axes.round(v - held.from[k], k));
    if (by.every((v, k) => v === 0 || (!axes.panel.map && k === 0))) { if (!held.moved) return; }
    const thing = held.thing, first = copy(held.first);
    if (held.part[0] === "between") this.between(first, held.part[1]);
    Object.assign(thing, first);
    if (held.part === "all" || held.part === "start") this.shift(thing, axes, by);
    else this.resize(thing, axes, held.part, by, to);
    held.moved = true;
    this.shifted = held.part === "start";
    this.shapes(this.views[held.p], held.p);
    this.send(held.part === "start" ? this.startSets(thing) : this.shapeSets(thing), held.sent);
    held.sent = true;
  }

  drop(event) {
    const held = this.held;
    this.held = null;
    if (!held) return;
    if (held.part === "new") {
      held.ghost.remove();
      if (event) this.created(held);
    } else if (held.part === "start") {
      this.shapes(this.views[held.p], held.p);
    }
  }

  /** Sends a change; `more` says that it goes on with the one before. */
  send(set, more) {
    this.waits = Number.MAX_SAFE_INTEGER;
    // Until the last change is answered, what the server saw is older than what is drawn.
    this.edit({set, more: Boolean(more)}).then(() => { this.waits = 1; this.key = ""; });
  }

  /** Moves a region or a start. */
  shift(thing, axes, by) {
    if (thing.kind === "halfspace") {
      this.push(thing, axes, thing.offset + thing.axes.reduce((sum, k, j) => sum + thing.normal[k] * by[j], 0));
      return;
    }
    const on = axes.panel.map ? thing.axes : [null, ...thing.axes];
    on.forEach((k, j) => {
      if (k === null) return;
      const add = (list, i) => { list[i] = axes.round(list[i] + by[j], j); };
      if (thing.tables) {
        const [table, state] = k, own = thing.tables[table], place = axes.panel.map ? j : 0;
        for (const key of ["initial_state", "initial_low", "initial_high"]) if (own[key]) add(own[key], state);
        add(thing.low, place);
        add(thing.high, place);
      } else if (thing.kind === "disc") add(thing.centre, k);
      else if (thing.kind === "cone") add(thing.tip, k);
      else if (thing.kind === "polygon") thing.corners.forEach(c => add(c, k));
      else { add(thing.low, k); add(thing.high, k); }
    });
  }

  /** Puts the edge of a half-space somewhere, by a number that is short to write. */
  push(s, axes, offset) {
    const step = Math.hypot(...s.normal) * Math.min(...axes.steps);
    s.offset = +offset.toFixed(Math.max(0, Math.ceil(-Math.log10(step))));
  }

  resize(s, axes, part, by, to) {
    const [what, i, j] = part;
    if (what === "turn") { this.turn(s, axes, i, to); return; }
    if (what === "axis" || what === "angle") {
      const way = s.axes.map((k, n) => to[n] - s.tip[k]), old = s.axes.map(k => s.axis[k]), far = Math.hypot(...way);
      if (far < Math.max(...axes.steps)) return;
      const cosine = (way[0] * old[0] + way[1] * old[1]) / far / Math.hypot(...old);
      if (what === "angle") s.angle = +Math.min(3.1, Math.max(0.05, 2 * Math.acos(Math.max(-1, Math.min(1, cosine))))).toFixed(2);
      else s.axes.forEach((k, n) => { s.axis[k] = +(way[n] / far * Math.hypot(...old)).toPrecision(3); });
      return;
    }
    if (what === "side") {
      const on = axes.panel.map ? s.axes : [null, ...s.axes];
      [i, j].forEach((side, k) => {
        const a = on[k], step = axes.steps[k];
        if (side < 0) s.low[a] = Math.min(axes.round(s.low[a] + by[k], k), axes.round(s.high[a] - step, k));
        if (side > 0) s.high[a] = Math.max(axes.round(s.high[a] + by[k], k), axes.round(s.low[a] + step, k));
      });
    } else if (what === "radius") {
      const c = s.axes.map(k => s.centre[k]), along = i < 2 ? 0 : 1;
      s.radius = Math.max(axes.steps[0], axes.round(Math.abs(to[along] - c[along]), along));
    } else {
      const corner = s.corners[what === "between" ? i + 1 : i], was = [...corner];
      s.axes.forEach((k, n) => { corner[k] = axes.round(corner[k] + by[n], n); });
      // A polygon stays convex: a corner that would turn inwards stays where it is.
      if (!this.convex(s.corners)) { corner.splice(0, corner.length, ...was); if (what === "between") s.corners.splice(i + 1, 1); }
    }
  }

  /** Turns the edge of a half-space around its other end. */
  turn(s, axes, end, to) {
    const edge = this.half(s, axes).edge, pivot = edge[1 - end], old = s.axes.map(k => s.normal[k]);
    const way = pivot && [0, 1].map(k => to[k] - pivot[k]), far = way && Math.hypot(...way), length = Math.hypot(...old);
    if (!far || far < Math.max(...axes.steps)) return;
    const side = [-way[1] / far, way[0] / far], sign = side[0] * old[0] + side[1] * old[1] < 0 ? -1 : 1;
    s.axes.forEach((k, n) => { s.normal[k] = +(sign * side[n] * length).toPrecision(3); });
    this.push(s, axes, s.axes.reduce((sum, k, n) => sum + s.normal[k] * pivot[n], 0));
  }

  /** Puts a corner into the middle of an edge. */
  between(s, k) {
    const a = s.corners[k], b = s.corners[(k + 1) % s.corners.length];
    s.corners.splice(k + 1, 0, a.map((v, n) => (v + b[n]) / 2));
  }

  cut(p, s, k) {
    if (s.corners.length < 4) return;
    s.corners.splice(k, 1);
    this.draw();
    this.send(this.shapeSets(s));
  }

  convex(corners) {
    const turns = corners.map((b, k) => {
      const a = corners[(k + corners.length - 1) % corners.length], c = corners[(k + 1) % corners.length];
      return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]);
    });
    return turns.every(t => t > 1e-9) || turns.every(t => t < -1e-9);
  }

  /** The values of the text that say where a region is. */
  shapeSets(s) {
    const keys = {box: ["low", "high"], disc: ["centre", "radius"], polygon: ["corners"], halfspace: ["normal", "offset"],
      cone: ["tip", "axis", "angle"]}[s.kind];
    return keys.map(key => [["propositions", s.name, ...s.at, key], copy(s[key])]);
  }

  startSets(s) {
    const sets = [];
    for (const own of Object.values(s.tables)) for (const key of ["initial_state", "initial_low", "initial_high"])
      if (own[key]) sets.push([[...own.path, key], copy(own[key])]);
    return sets;
  }

  arrow(event, axes) {
    const many = event.shiftKey ? 10 : 1, sign = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1]}[event.key];
    if (!sign) return null;
    event.preventDefault();
    return sign.map((v, k) => v * many * axes.steps[k]);
  }

  key_(event, p, s) {
    const {axes} = this.views[p], by = this.arrow(event, axes);
    if (by) { this.shift(s, axes, by); this.send(this.shapeSets(s)); this.draw(); }
    if (event.key === "Delete" || event.key === "Backspace") { event.preventDefault(); if (!s.part) this.remove(s.name); }
  }

  // New regions.

  sketch(held, axes) {
    const {from, to, ghost} = held;
    if (this.tool === "disc") {
      const r = Math.hypot(to[0] - from[0], to[1] - from[1]);
      const set = {cx: axes.x(from[0]), cy: axes.y(from[1]), rx: axes.x(from[0] + r) - axes.x(from[0]), ry: axes.y(from[1]) - axes.y(from[1] + r)};
      for (const key in set) ghost.setAttribute(key, set[key]);
    } else {
      const points = this.tool === "polygon" ? this.rounded(from, to) : [from, [to[0], from[1]], to, [from[0], to[1]]];
      ghost.setAttribute("d", "M" + points.map(q => axes.x(q[0]) + " " + axes.y(q[1])).join("L") + "Z");
    }
  }

  /** Corners of a polygon in the box that was drawn. */
  rounded(from, to) {
    const middle = [0, 1].map(k => (from[k] + to[k]) / 2), half = [0, 1].map(k => Math.abs(to[k] - from[k]) / 2);
    return Array.from({length: CORNERS}, (_, k) => k * 2 * Math.PI / CORNERS)
      .map(a => [middle[0] + half[0] * Math.cos(a), middle[1] + half[1] * Math.sin(a)]);
  }

  created(held) {
    const {axes, panel} = this.views[held.p], span = [0, 1].map(k => axes.high[k] - axes.low[k]);
    let {from, to} = held;
    // A click makes a region of a usual size.
    if (from.every((v, k) => Math.abs(v - to[k]) < span[k] / 50)) {
      const half = this.tool === "disc" ? 0 : 1;
      [from, to] = [from.map((v, k) => v - half * span[k] / 12), from.map((v, k) => v + span[k] / 12)];
    }
    const own = panel.new.find(n => n.agent === at("agent").value) || panel.new[0];
    if (!own) { at("hint").textContent = "regions of this panel are written in the text"; return; }
    if (this.tool !== "box" && own.states.length < 2) { at("hint").textContent = "one coordinate: draw a box"; return; }
    const table = {agent: own.agent, ...this.table(axes, own, from, to)}, name = this.free(WORDS[at("role").value]);
    const edit = {add: [name, table], role: at("role").value};
    this.chosen = name;
    this.take("move");
    this.edit(edit);
  }

  /** How a region that was drawn is written. */
  table(axes, own, from, to) {
    const of = own.plain || own.states.every((s, k) => s === k) ? {} : {of: own.states};
    if (this.tool === "disc") {
      const r = Math.hypot(to[0] - from[0], to[1] - from[1]);
      return {disc: {...of, centre: from.map((v, k) => axes.round(v, k)), radius: Math.max(axes.steps[0], axes.round(r, 0))}};
    }
    if (this.tool === "polygon") return {polygon: {...of, corners: this.rounded(from, to).map(c => c.map((v, k) => axes.round(v, k)))}};
    const keep = axes.panel.map ? [0, 1] : [1];
    const low = keep.map(k => axes.round(Math.min(from[k], to[k]), k)), high = keep.map(k => axes.round(Math.max(from[k], to[k]), k));
    keep.forEach((k, n) => { if (high[n] <= low[n]) high[n] = axes.round(low[n] + axes.steps[k], k); });
    const whole = own.states.length === own.all ? {} : {of: own.states};
    return own.plain ? {low, high} : {box: {...whole, low, high}};
  }

  free(word) {
    const taken = new Set(this.picture.panels.flatMap(p => [...p.shapes, ...p.regions].map(s => s.name)));
    const written = at("text").value;
    for (let k = 1; ; k++) {
      const name = k === 1 ? word : word + "_" + k;
      if (!taken.has(name) && !new RegExp("\\b" + name + "\\b").test(written.replace(/#.*$/gm, ""))) return name;
    }
  }

  remove(name) {
    if (!name) return;
    this.chosen = "";
    this.edit({remove: name});
  }

  // Episodes.

  clear() { for (const view of this.views) view.ways.replaceChildren(); }

  episodes(run, time) {
    this.clear();
    run.panels.forEach((curves, p) => {
      const view = this.views[p];
      if (!view) return;
      const {axes, ways} = view, place = (q, t) => (axes.panel.map ? q : [t, q[0]]);
      for (const curve of curves) curve.paths.forEach((path, m) => {
        const shown = path.slice(0, time + 1).map(place), good = run.success[m], over = time >= path.length - 1;
        if (shown.some(q => q.length < 2)) return;
        const points = shown.map(q => axes.x(q[0]).toFixed(1) + "," + axes.y(q[1]).toFixed(1)).join(" ");
        make(ways, "polyline", {class: "way agent" + curve.color + (good ? "" : " lost"), points});
        const [x, y] = shown[shown.length - 1], px = axes.x(x), py = axes.y(y);
        if (over && !good) make(ways, "path", {class: "over", d: "M" + (px - 5) + " " + (py - 5) + "l10 10m0 -10l-10 10"});
        else if (curve.headings) make(ways, "polygon", {class: "now agent" + curve.color,
          points: pointing(px, py, 9, curve.headings[m][Math.min(time, path.length - 1)])});
        else make(ways, "circle", {class: "now agent" + curve.color, cx: px, cy: py, r: 4.5});
      });
    });
  }
}
