// What is certified: the bound as it grows, its upper end, the ways that were tried, and episodes of the controllers.

const at = id => document.getElementById(id), NS = "http://www.w3.org/2000/svg";
const FRAME = 70, LEAST = 12;  // milliseconds of a step, and powers of ten of a failure

export class Result {
  constructor(link, picture) {
    Object.assign(this, {link, picture, run: null, timer: null, seed: 0});
    at("certify").onclick = () => this.certify();
    at("stop").onclick = () => link.post("stop", {});
    at("play").onclick = () => this.play();
    at("again").onclick = () => { this.seed += 1; this.simulate(); };
    document.querySelectorAll("[data-keep]").forEach(b => { b.onclick = () => this.keep(b.dataset.keep); });
    at("time").oninput = () => { this.halt(); this.frame(); };
  }

  async certify() {
    const seconds = parseFloat(at("seconds").value);
    this.halt();
    this.seed = 0;
    if (this.link.dirty) await this.link.send();
    this.say(await this.link.post("certify", {seconds: seconds > 0 ? seconds : null}));
  }

  async keep(ending) {
    const name = this.link.state.file.name.replace(/\.toml$/, "") + ending;
    this.say(await this.link.post("certificate", {name}));
  }

  say(answer) {
    if (!answer.ok && answer.status) this.link.ask("result", answer.error, ["Well", () => {}]);
  }

  show(state) {
    const job = state.job, busy = ["running", "stopping", "playing"].includes(job.state), seen = state.seen;
    const found = job.result, home = at("result");
    const old = Boolean(found && seen && (seen.error || seen.fingerprint !== found.fingerprint));
    home.className = (job.state === "failed" ? "nothing" : found && found.valid ? (found.lower_bound > 0 ? "proved" : "nothing") : "") +
      (old ? " old" : "");
    at("certify").hidden = busy;
    at("certify").disabled = Boolean(!seen || seen.error) || this.link.away;
    at("stop").hidden = !busy;
    at("stop").textContent = job.state === "stopping" ? "Stop at once" : "Stop";
    at("bound").textContent = this.bound(job);
    at("upper").textContent = this.upper(job);
    at("way").textContent = this.words(job, old, state.message);
    this.curve(job);
    at("after").hidden = !found || job.state !== "done" && job.state !== "playing";
    at("play").disabled = at("again").disabled = job.state === "playing" || this.link.away;
    this.tried(found);
    this.picture.take_maps(found && found.maps, job.number, old);
    this.take(state.run, old);
  }

  bound(job) {
    if (job.result) return "P ≥ " + (job.result.claim.replace(/^P >= /, "").replace(/,? ?P <=.*/, ""));
    if (job.now) return job.now.bound > 0 ? "P ≥ " + job.now.shown : "nothing certified yet";
    return job.state === "failed" ? "Nothing was certified" : "";
  }

  upper(job) {
    if (job.result) {
      const above = job.result.above_shown;
      return [job.result.words, above === null ? "" : "no controller does better than " + above,
        job.result.start === "mean" ? "on average over the box of starts" : ""].filter(Boolean).join("; ");
    }
    const most = job.now && /, at most ([0-9.]*[0-9])/.exec(job.now.way);
    return most ? "no controller does better than " + most[1] : "";
  }

  words(job, old, message) {
    if (job.state === "failed") return job.why;
    if (job.state === "playing") return "simulating …";
    if (!job.result) {
      if (!job.now) return job.state === "none" ? "The bound that is certified will stand here." : "begins …";
      const search = job.now.search === null ? "" : "; this search: " + job.now.search.toFixed(6);
      return job.now.way + search + " [" + Math.round(job.now.seconds) + " s]";
    }
    const found = job.result, check = found.valid === null ? "not checked: stopped before" :
      found.valid ? "checked by separate code" : "the separate check FAILED: " + found.failures.join("; ");
    return [job.why, found.nothing, found.stopped ? "stopped: the best so far" : "", check, found.method, found.seconds.toFixed(1) + " s",
      old ? "about an earlier text" : "", message].filter(Boolean).join("; ");
  }

  /** Draws the failure that is proved against the seconds, by its powers of ten: what is gained falls. */
  curve(job) {
    const svg = at("curve"), points = (job.told || []).slice();
    svg.textContent = "";
    if (job.result) points.push([job.result.seconds, job.result.lower_bound]);
    svg.toggleAttribute("hidden", !points.length);
    if (!points.length) return;
    const power = p => Math.max(-LEAST, Math.log10(Math.max(1 - p, 1e-99))), best = Math.max(...points.map(q => q[1]));
    const deepest = Math.min(-1, Math.floor(power(best))), every = Math.ceil(-deepest / 4);
    const end = Math.max(points[points.length - 1][0], 0.1), x = t => 36 + 258 * t / end;
    const y = p => 8 + 76 * Math.min(1, power(p) / deepest), low = y(1);
    const add = (name, set, text) => {
      const e = document.createElementNS(NS, name);
      for (const key in set) e.setAttribute(key, set[key]);
      if (text !== undefined) e.textContent = text;
      svg.append(e);
    };
    for (let k = 0; k >= deepest; k -= every) {
      const height = y(1 - 10 ** k);
      add("line", {class: "grid", x1: 36, x2: 294, y1: height, y2: height});
      add("text", {class: "tick end", x: 32, y: height + 3.5}, k > -3 ? 10 ** k : "1e" + k);
    }
    add("text", {class: "tick", x: 40, y: 95}, "fails at most");
    add("text", {class: "tick end", x: 294, y: 95}, end.toFixed(1) + " s");
    let line = "M" + x(0) + " " + y(0), most = 0;
    for (const [t, p] of points) line += "H" + x(t) + "V" + y(most = Math.max(most, p));
    add("path", {class: "fill", d: line + "H" + x(end) + "V" + low + "H" + x(0) + "Z"});
    add("path", {class: "rise", d: line + "H" + x(end)});
    const above = job.result ? job.result.above : null, told = parseFloat((/than ([0-9.]+)/.exec(this.upper(job)) || [])[1]);
    const top = above === null ? told : above;
    if (top < 1 && power(top) >= deepest) add("line", {class: "most", x1: 36, x2: 294, y1: y(top), y2: y(top)});
  }

  tried(found) {
    const rows = found ? found.tried : [], home = at("tried"), key = JSON.stringify(rows);
    home.hidden = !rows.length;
    if (this.rows === key) return;
    this.rows = key;
    home.querySelector("table").replaceChildren(...rows.map(row => {
      const tr = document.createElement("tr");
      tr.append(...row.map(text => Object.assign(document.createElement("td"), {textContent: text})));
      return tr;
    }));
  }

  // Episodes.

  take(run, old) {
    const key = run ? run.number + "/" + run.seed : "";
    at("again").hidden = at("played").hidden = !run;
    at("time").disabled = !run;
    if (old && this.run) this.halt();
    if (key === this.key) return;
    this.key = key;
    this.run = run;
    this.halt();
    if (!run) { at("time").value = 0; this.picture.clear(); return; }
    const good = run.success.filter(Boolean).length;
    at("played").textContent = good + " of these " + run.success.length + " episodes satisfied the task; of " + run.episodes +
      ", " + (100 * run.estimate).toFixed(2) + " % (an estimate)";
    at("time").max = Math.max(...run.lengths) - 1;
    at("time").value = 0;
    this.start();
  }

  simulate() { this.link.post("play", {seed: this.seed}).then(answer => this.say(answer)); }

  play() {
    if (!this.run) this.simulate();
    else if (this.timer) this.halt();
    else this.start();
  }

  start() {
    if (+at("time").value >= +at("time").max) at("time").value = 0;
    at("play").textContent = "Pause";
    let last = performance.now();
    const step = now => {
      if (now - last >= FRAME) { at("time").value = +at("time").value + 1; last = now; this.frame(); }
      if (+at("time").value >= +at("time").max) this.halt();
      else this.timer = requestAnimationFrame(step);
    };
    this.frame();
    this.timer = requestAnimationFrame(step);
  }

  halt() {
    cancelAnimationFrame(this.timer);
    this.timer = null;
    at("play").textContent = "Play";
  }

  /** Draws the episodes up to the time of the slider. */
  frame() { if (this.run) this.picture.episodes(this.run, +at("time").value); }
}
