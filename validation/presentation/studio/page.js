// The page: what the tabs share comes from the server (link.js); editor, picture and result show it.
import {Link} from "./link.js";
import {Editor} from "./editor.js";
import {Picture} from "./picture.js";
import {Result} from "./result.js";

const at = id => document.getElementById(id);
const link = new Link(show, ask, told);
const editor = new Editor(text => link.write(text));
const picture = new Picture(edit => link.edit(edit), state => result.frame(state));
const result = new Result(link, picture);
window.studio = {link, editor, picture, result};

/** Shows a state of the server. */
function show(state) {
  const seen = state.seen, saved = state.file.exists && state.file.saved;
  at("file").textContent = state.file.name;
  at("file").title = state.file.folder;
  at("unsaved").hidden = saved || (!state.file.exists && link.text === "");
  document.title = (saved ? "" : "• ") + state.file.name + " – certigym studio";
  editor.show(link.text);
  at("begin").hidden = link.text.trim() !== "";
  at("panels").hidden = at("tools").hidden = at("result").hidden = link.text.trim() === "";
  if (seen) {
    const formula = at("formula");
    editor.mark(state.current && link.text.trim() ? seen.error : null, link.text === state.text);
    if (document.activeElement !== formula) formula.value = seen.formula === null ? "" : seen.formula;
    formula.disabled = seen.formula === null;
    at("facts").textContent = facts(seen);
    picture.show(seen, state.current && link.text === state.text, state.revision);
  }
  result.show(state);
}

/** Says what a task is made of, in words. */
function facts(seen) {
  const f = seen.facts;
  if (!f || seen.error) return "";
  const agents = f.agents + (f.agents === 1 ? " agent" : " agents"), sizes = f.states.join(", ");
  return f.name + ": " + agents + ", " + f.horizon + " steps, " + f.semantics + ", " +
    (f.tasks > 1 ? f.tasks + " independent tasks" : "automaton of " + sizes + " states");
}

let asked = "";

/** Asks a question above everything else: what it is about, and two answers (words and what they do). */
function ask(key, question, yes, no) {
  const banner = at("banner"), buttons = banner.querySelectorAll("button");
  asked = key;
  banner.hidden = !key;
  if (!key) return;
  banner.querySelector("span").textContent = question;
  [yes, no].forEach((answer, k) => {
    buttons[k].hidden = !answer;
    if (!answer) return;
    buttons[k].textContent = answer[0];
    buttons[k].onclick = () => { if (asked === key) ask(""); answer[1](); };
  });
}

/** Says how the page stands to its server. */
function told(words, off) {
  at("link").textContent = words;
  at("link").classList.toggle("off", off);
}

async function save(anyway) {
  const answer = await link.post("save", {anyway: anyway});
  if (answer.ok) ask("");
  else if (answer.status === 409) ask("save", answer.error, ["Replace it", () => save(true)], ["Leave it", () => {}]);
  else if (answer.status) ask("save", answer.error, ["Well", () => {}]);
}

at("save").onclick = () => save(false);
at("undo").onclick = () => link.undo(-1);
at("redo").onclick = () => link.undo(1);
document.addEventListener("keydown", event => {
  if (!(event.ctrlKey || event.metaKey)) return;
  const key = event.key.toLowerCase();
  if (key === "s") { event.preventDefault(); save(false); }
  if (key === "z" && document.activeElement !== at("formula")) {
    event.preventDefault();
    link.undo(event.shiftKey ? 1 : -1);
  }
  if (key === "enter") { event.preventDefault(); at("certify").click(); }
});
at("formula").addEventListener("input", event => link.edit({formula: event.target.value}));
document.querySelectorAll("[data-begin]").forEach(button => {
  button.onclick = () => link.write(at("begin-" + button.dataset.begin).content.textContent.trimStart(), true);
});
link.start();
