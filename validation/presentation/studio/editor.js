// The text of the problem file: coloured, with line numbers, and a mark under the mistake that an error is about.

const WORDS = /(#.*$)|("""|'''|"(?:\\.|[^"\\])*"|'[^']*')|(^\s*\[\[?[^\]]*\]\]?)|(^\s*[\w.-]+(?=\s*=)|[\w-]+(?=\s*=))/gm;
const KINDS = ["", "c", "s", "h", "k"];
const escaped = text => text.replace(/&/g, "&amp;").replace(/</g, "&lt;");

export class Editor {
  constructor(write) {
    this.home = document.getElementById("editor");
    this.area = document.getElementById("text");
    this.paper = this.home.querySelector("pre");
    this.caret = this.home.querySelector(".caret");
    this.error = document.getElementById("error");
    this.area.addEventListener("input", () => write(this.area.value));
    this.area.addEventListener("scroll", () => this.scroll());
    this.area.addEventListener("keydown", event => this.tab(event));
    this.error.onclick = () => this.go();
    this.place = null;
  }

  /** Shows a text; the cursor stays where it is. */
  show(text) {
    if (this.area.value !== text) {
      const {selectionStart: a, selectionEnd: b, scrollTop, scrollLeft} = this.area;
      this.area.value = text;
      if (document.activeElement === this.area) this.area.setSelectionRange(Math.min(a, text.length), Math.min(b, text.length));
      Object.assign(this.area, {scrollTop, scrollLeft});
    }
    if (this.shown === text) return;
    this.shown = text;
    this.paper.innerHTML = text.split("\n").map(line => '<span class="line">' + this.colour(line) + "</span>").join("\n");
    this.scroll();
  }

  colour(line) {
    let out = "", last = 0;
    for (const found of line.matchAll(WORDS)) {
      const kind = [1, 2, 3, 4].find(k => found[k] !== undefined);
      out += escaped(line.slice(last, found.index)) + '<span class="' + KINDS[kind] + '">' + escaped(found[0]) + "</span>";
      last = found.index + found[0].length;
    }
    return out + escaped(line.slice(last));
  }

  /** Shows an error, and a mark below the characters that it is about. */
  mark(error, placed) {
    this.home.classList.toggle("wrong", Boolean(error));
    this.error.hidden = !error;
    this.caret.hidden = !(error && error.mark && placed);
    this.place = error && error.mark;
    if (!error) return;
    this.error.textContent = error.message;
    if (this.caret.hidden) return;
    const [from, to] = error.mark, column = error.column - 1, line = this.area.value.slice(from, to).split("\n")[0];
    this.caret.style.width = Math.max(1, line.length) + "ch";
    this.caret.dataset.line = error.line;
    this.caret.dataset.column = error.column;
    this.caret.style.marginLeft = "calc(3.2em + " + column + "ch)";
    this.caret.style.marginTop = 10 + 19 * (error.line - 1) + "px";
  }

  go() {
    if (!this.place) return;
    this.area.focus();
    this.area.setSelectionRange(this.place[0], this.place[1]);
    const line = this.area.value.slice(0, this.place[0]).split("\n").length;
    this.area.scrollTop = 19 * line - this.area.clientHeight / 2;
  }

  scroll() {
    const move = "translate(" + -this.area.scrollLeft + "px," + -this.area.scrollTop + "px)";
    this.paper.style.transform = this.caret.style.transform = move;
  }

  tab(event) {
    // Tab leaves the text, as everywhere on a page; Escape does, too.
    if (event.key === "Escape") this.area.blur();
  }
}
