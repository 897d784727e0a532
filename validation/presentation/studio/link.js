// The link to the server: the text goes there after every change, what all tabs see comes back. Nothing that was written
// is lost: while the server is away the text stays here and in this browser's storage, and goes there once it is back.

const PAUSE = 120, RETRY = 700, LATER = 1500, MOST_UNDO = 300;

export class Link {
  /** Takes what shows a state, what asks a question, and what says how the link stands. */
  constructor(show, ask, told) {
    Object.assign(this, {show, ask, told, state: null, text: "", base: -1, synced: "", dirty: false, away: false});
    Object.assign(this, {past: [], future: [], timer: null, sending: null, edits: [], editing: null, root: location.pathname});
    this.others = new Set();
    this.me = Math.random().toString(36).slice(2);
  }

  start() {
    this.channel = new BroadcastChannel("certigym-studio");
    this.channel.onmessage = event => this.hear(event.data);
    addEventListener("pagehide", () => this.call("bye"));
    addEventListener("beforeunload", () => this.remember());
    this.poll();
  }

  // Tabs.

  get place() { return this.state ? this.state.file.folder + "/" + this.state.file.name : ""; }

  call(word) {
    if (this.place) this.channel.postMessage({word, from: this.me, place: this.place, root: this.root, away: this.away});
  }

  hear(message) {
    if (message.place !== this.place) return;
    if (message.word === "bye") this.others.delete(message.from);
    else this.others.add(message.from);
    if (message.word === "hello") this.call("here");
    // Another tab of this file has a server: it is asked in the place of the one that is gone.
    if (this.away && !message.away && message.root !== this.root) {
      this.root = message.root;
      history.replaceState(null, "", this.root);
    }
    this.tell();
  }

  tell() {
    const tabs = this.others.size + 1;
    if (this.away) this.told("server stopped: your text is kept here; start it again, and open its page", true);
    else this.told(tabs > 1 ? "open in " + tabs + " tabs, which show the same" : "", false);
  }

  // What comes from the server.

  async poll() {
    for (;;) {
      const since = this.state && !this.away ? this.state.version : -1;
      const signal = AbortSignal.timeout(40000);
      try {
        const answer = await fetch(this.root + "state?since=" + since, {signal});
        if (!answer.ok) throw new Error(answer.status);
        this.take(await answer.json());
      } catch (error) {
        this.lost();
        await new Promise(done => setTimeout(done, RETRY));
      }
    }
  }

  lost() {
    if (this.away) { this.call("hello"); return; }
    this.away = true;
    this.remember();
    this.tell();
    if (this.state) this.show(this.state);
  }

  /** Takes a state, and the text in it unless one was written here meanwhile. */
  take(state) {
    const first = !this.state, other = !first && this.state.session !== state.session;
    const older = !first && !other && state.version < this.state.version;
    if (older) return;
    const disk = this.synced;
    this.state = state;
    if (this.away) { this.away = false; this.ask(""); }
    if (first) { this.adopt(state); this.call("hello"); this.recall(); }
    else if (other) this.again(state, disk);
    else if (state.revision !== this.base) this.merge(state);
    this.tell();
    this.remember();
    this.show(state);
  }

  adopt(state) {
    if (state.text !== this.text && this.base >= 0) this.push(this.text);
    Object.assign(this, {text: state.text, base: state.revision, synced: state.text, dirty: false});
  }

  merge(state) {
    if (state.text === this.text || !this.dirty) { this.adopt(state); return; }
    if (this.sending) return;  // the answer says more
    this.conflict(state);
  }

  /** The server was started anew: what was written here goes there, unless the file says something new, too. */
  again(state, before) {
    this.base = state.revision;
    if (state.text === this.text) { this.adopt(state); return; }
    const known = state.text === before || !state.file.exists || state.text === this.onDisk;
    if (!known && this.dirty) { this.conflict(state); return; }
    if (this.dirty) { this.send(); return; }
    // Nothing was written here since: a tab in which something was comes first, and then this one takes its text.
    setTimeout(() => {
      if (this.state.session !== state.session || this.dirty || this.state.text === this.text) return;
      if (this.state.revision > state.revision) { this.adopt(this.state); this.show(this.state); return; }
      if (!known) { this.conflict(this.state); return; }
      this.dirty = true;
      this.send();
    }, LATER);
  }

  conflict(state) {
    const mine = this.text;
    this.ask("conflict", "The text was changed elsewhere, too (in another tab, or in the file).",
      ["Keep mine", () => { this.base = this.state.revision; this.text = mine; this.dirty = true; this.send(); }],
      ["Take the other", () => { this.adopt(this.state); this.remember(); this.show(this.state); }]);
  }

  // What was written here and is not in the file stays in the browser, by file.

  remember() {
    if (!this.state) return;
    const key = "certigym-studio:" + this.place;
    const saved = !this.away && !this.dirty && this.state.file.exists && this.state.file.saved;
    if (saved) { this.onDisk = this.state.text; localStorage.removeItem(key); }
    else if (this.text.trim() && !this.recalled) localStorage.setItem(key, JSON.stringify({text: this.text, at: Date.now()}));
  }

  recall() {
    const key = "certigym-studio:" + this.place, kept = localStorage.getItem(key);
    const draft = kept && JSON.parse(kept);
    if (!draft || draft.text === this.text || this.state.revision > 0) return;
    this.recalled = true;
    const done = text => { this.recalled = false; if (text === null) localStorage.removeItem(key); else this.write(text, true); };
    this.ask("draft", "This browser kept a text of this file that was not saved (" + new Date(draft.at).toLocaleString() + ").",
      ["Restore it", () => done(draft.text)], ["Forget it", () => done(null)]);
  }

  // What goes to the server.

  push(text) {
    if (this.past[this.past.length - 1] === text) return;
    this.past.push(text);
    this.future = [];
    if (this.past.length > MOST_UNDO) this.past.shift();
  }

  /** Takes a text that was written here; it is sent after a short pause. */
  write(text, now) {
    if (text === this.text) return;
    // Letters typed in one go are undone in one go.
    if (!this.lately || now) this.push(this.text);
    clearTimeout(this.lately);
    this.lately = setTimeout(() => { this.lately = null; }, 700);
    this.set(text, now);
  }

  set(text, now) {
    Object.assign(this, {text, dirty: true, recalled: false});
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.send(), now ? 0 : PAUSE);
    this.remember();
    this.show(this.state);
  }

  undo(direction) {
    const from = direction < 0 ? this.past : this.future, to = direction < 0 ? this.future : this.past;
    if (!from.length) return;
    to.push(this.text);
    this.set(from.pop(), true);
  }

  /** Sends the text; one at a time. */
  async send() {
    clearTimeout(this.timer);
    this.timer = null;
    if (this.sending || !this.dirty || this.away) return;
    const text = this.text;
    this.sending = this.post("text", {text, base: this.base});
    const answer = await this.sending;
    this.sending = null;
    if (answer.ok) {
      Object.assign(this, {base: answer.state.revision, synced: text, dirty: this.text !== text});
      this.take(answer.state);
      if (this.dirty) this.send();
    } else if (answer.status === 409) this.conflict(answer.state);
    else if (answer.status) this.ask("text", answer.error, ["Well", () => {}]);
  }

  /** Sends a change of the picture, and is done when none is left to send; of those of one drag that wait the last counts. */
  edit(edit) {
    const waits = this.edits.at(-1), goes = waits && (edit.more || ("formula" in edit && "formula" in waits));
    if (goes) this.edits[this.edits.length - 1] = {...edit, more: waits.more};
    else this.edits.push(edit);
    this.editing = this.editing || this.sendEdits();
    return this.editing;
  }

  async sendEdits() {
    while (this.edits.length) {
      if (this.dirty) await this.send();
      const {more, ...change} = this.edits.shift();
      if (!more) this.push(this.text);
      const answer = await this.post("edit", {edit: change, base: this.base});
      if (answer.ok) { this.adoptEdit(answer.state); this.ask(""); }
      else if (answer.status) this.ask("edit", answer.error, ["Well", () => {}]);
    }
    this.editing = null;
  }

  adoptEdit(state) {
    Object.assign(this, {text: state.text, base: state.revision, synced: state.text, dirty: false});
    this.take(state);
  }

  /** Asks the server to do something; the answer has `ok`, `status` (0: no answer), `error` and `state`. */
  async post(action, body) {
    try {
      const answer = await fetch(this.root + action, {
        method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(body),
      });
      const data = await answer.json();
      if (answer.ok) { if (action !== "text" && action !== "edit") this.take(data); return {ok: true, status: 200, state: data}; }
      return {ok: false, status: answer.status, error: data.error, state: data.state};
    } catch (error) {
      this.lost();
      return {ok: false, status: 0};
    }
  }
}
