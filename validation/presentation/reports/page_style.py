"""Style sheet of a report page: light, dark, narrow and printed; and the script of its player.

The page loads nothing. Without scripts it shows all that it says but single episodes and the explorer.
"""

from __future__ import annotations

from ....envs.interfaces import AGENTS, AGENTS_ON_DARK, LOOKS

_COMMON = """
:root{--ink:#1b2430;--soft:#566372;--paper:#fbfbf9;--card:#fff;--line:#dfe3e8;--bound:#1f5fae;--run:#c2571a;
--bad:#b3261e;--good:#1e7d4f;--here:#e9b949;color-scheme:light dark}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#9aa6b4;--paper:#14181e;--card:#1c222a;--line:#313a45;
--bound:#7db2ef;--run:#f0a06b;--bad:#ff8a80;--good:#74d3a2;--here:#8d6d1d}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,
"DejaVu Sans",sans-serif}
main{max-width:1000px;margin:0 auto;padding:28px 18px 60px}
h1{font-size:1.6rem;margin:0}.alarm{color:var(--bad);font-size:2.1rem;line-height:1.15}
h2{font-size:1.15rem;margin:44px 0 4px;padding-top:12px;border-top:1px solid var(--line)}
h3{font-size:.95rem;margin:0 0 4px}p{margin:4px 0;max-width:72ch}.soft{color:var(--soft);font-size:.88rem}
.task{margin-top:8px}figure{margin:0;min-width:0}figcaption{color:var(--soft);font-size:.86rem;margin-top:4px}
.row{display:grid;gap:24px;margin-top:12px;grid-template-columns:repeat(auto-fit,minmax(min(380px,100%),1fr))}
.answer{display:grid;gap:24px;grid-template-columns:repeat(auto-fit,minmax(min(380px,100%),1fr));align-items:center;
margin-top:20px;padding:20px;background:var(--card);border:1px solid var(--line);border-left:6px solid #3f566f;
border-radius:8px}
.answer.is-confirmed{border-left-color:var(--good)}.answer:is(.is-refuted,.is-invalid){border-left-color:var(--bad)}
.answer h2{border:0;margin:0 0 4px;padding:0;font-size:.95rem;color:var(--soft)}
.big{font-size:1.35rem;font-weight:650;line-height:1.25;overflow-wrap:anywhere}.whole{white-space:nowrap}.words{font-size:1.1rem}
.verdict{display:inline-block;text-indent:0;
padding:1px 12px;border-radius:14px;font-weight:600;color:#fff;background:#3f566f}
.confirmed{background:#1a6e45}.refuted,.invalid{background:#a3211a}.vacuous{background:#6b5a1e}
.tests{list-style:none;margin:10px 0 0;padding:0;font-size:.92rem}.tests li{padding:2px 0 2px 1.5em;text-indent:-1.5em}
.tests .yes::before{content:"\\2713";color:var(--good);display:inline-block;width:1.5em;text-indent:0}
.tests .open::before{content:"\\2013";color:var(--soft);display:inline-block;width:1.5em;text-indent:0}
.tests .no::before{content:"\\2717";color:var(--bad);display:inline-block;width:1.5em;text-indent:0}
.player{display:flex;flex-wrap:wrap;gap:8px 14px;align-items:center;margin-top:10px}
.player[hidden]{display:none}.player input{flex:1 1 160px;min-width:0}
.player button,.player select{font:inherit;font-size:.88rem;padding:3px 12px;border:1px solid var(--line);
border-radius:6px;background:var(--card);color:var(--ink)}
.playing .all{opacity:.13}.one polyline{stroke-width:2.4;fill:none}
.one :is(circle,polygon){stroke:var(--card);stroke-width:1}
.here{fill:var(--here)!important}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 18px;margin:8px 0;font-size:.92rem}dt{color:var(--soft)}
dd{margin:0;min-width:0;overflow-wrap:anywhere}table{border-collapse:collapse;width:100%;font-size:.86rem}
th,td{text-align:left;padding:3px 14px 3px 0;border-top:1px solid var(--line);vertical-align:top}
td:last-child{overflow-wrap:anywhere;width:100%}td{white-space:nowrap}td:last-child{white-space:normal}
code,pre{font:.82rem/1.45 ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace}
pre{overflow-x:auto;white-space:pre-wrap;overflow-wrap:anywhere;margin:4px 0}.scroll{overflow-x:auto}
code{overflow-wrap:anywhere}
svg{width:100%;height:auto;display:block}svg text{font:11px system-ui,"DejaVu Sans",sans-serif;fill:var(--ink)}
svg .tick{font-size:10px;fill:var(--soft)}svg .name{fill:var(--soft)}svg .middle{text-anchor:middle}
svg .end{text-anchor:end}line.grid{stroke:var(--line);stroke-width:1}polyline,.arrow{fill:none}
.bound{stroke:var(--bound);stroke-width:2}.bound-dot{fill:var(--bound)}.estimate{stroke:var(--run);stroke-width:1.5}
.sure{fill:var(--bound);fill-opacity:.75}.sure.open{fill-opacity:.22}
.estimate-dot{fill:var(--run)}.bad-dot{fill:var(--bad)}.cell{fill:var(--bound)}.over{fill:var(--bound)}
.under{fill:var(--run)}.bad-cell{fill:var(--bad)}.sure-dot{fill:var(--good);stroke:var(--card);stroke-width:.4}
.region{stroke-width:1}.region-name{paint-order:stroke}
.tube{stroke-width:.8;stroke-opacity:.6;
fill-opacity:.13}
svg .region-name{font-size:9.5px;fill:var(--soft)}.path{stroke-width:1;stroke-opacity:.55}
.path.lost{stroke-dasharray:3 2}circle.path{fill-opacity:.8;stroke:none}
.state,.accepting,.dead{fill:var(--card);stroke:var(--ink);stroke-width:1.3}
.accepting{stroke:var(--good);stroke-width:1.8}.dead{stroke:var(--bad)}svg .state-name{font-size:10px}
.arrow{stroke:var(--soft);stroke-width:1.1}.tip{fill:var(--soft)}
.key{display:inline-block;width:.8em;height:.8em;border-radius:2px;margin:0 4px 0 0;background:currentColor}
.key.k-bound{color:var(--bound)}.key.k-run{color:var(--run)}.key.k-bad{color:var(--bad)}.key.k-good{color:var(--good)}
"""

_PRINT = """@media print{body{background:#fff;font-size:10pt}main{max-width:none;padding:0}.player{display:none}
.answer,tr{break-inside:avoid}figcaption{break-before:avoid}h2{break-after:avoid;margin-top:18px}details{display:none}
.row table{font-size:.75rem;line-height:1.2}.row table :is(td,th){padding-block:1px}
.row,.answer{grid-template-columns:1fr 1fr;gap:14px}.row>figure:only-child{max-width:60%}svg{max-height:9cm}
.playing .all{opacity:1}.one{display:none}.here{fill:var(--card)!important}}
"""

_LINES = {"/": "M0 8L8 0", "x": "M0 8L8 0M0 0L8 8", "-": "M0 4H8", "|": "M4 0V8", "\\": "M0 0L8 8"}
"""The lines of one tile of a hatch, 8 units wide and high."""


def _agents(colors: tuple[str, ...]) -> str:
    """Return the rules of agents: lines, dots, tubes and keys in their colours."""
    return "".join(
        f".agent{k}{{stroke:{color}}}:is(circle,polygon).agent{k}{{fill:{color}}}.k-agent{k}{{color:{color}}}"
        for k, color in enumerate(colors)
    )


def _regions() -> str:
    """Return the rules of regions by their roles: rims, the hatch of `PATTERNS`, and keys."""
    return "".join(
        f".r-{role}{{fill:url(#look-{role});stroke:{look.color}}}.k-{role}{{color:{look.color}}}"
        for role, look in LOOKS.items()
    )


STYLE = (
    f"{_COMMON}{_regions()}{_agents(AGENTS)}\n@media (prefers-color-scheme:dark){{{_agents(AGENTS_ON_DARK)}}}\n"
    f"@media print{{{_agents(AGENTS)}}}\n{_PRINT}"
)
"""The style sheet; agents have lighter colours on a dark page, and those of paper in print."""

PATTERNS = (
    '<svg width="0" height="0" style="position:absolute" aria-hidden="true"><defs>'
    + "".join(
        f'<pattern id="look-{role}" width="8" height="8" patternUnits="userSpaceOnUse">'
        f'<path d="M0 0H8V8H0z" fill="{look.color}" fill-opacity=".16"/>'
        f'<path d="{_LINES.get(look.hatch, "")}" fill="none" stroke="{look.color}" stroke-opacity=".55"/></pattern>'
        for role, look in LOOKS.items()
    )
    + "</defs></svg>"
)
"""The fills of regions, which the style sheet refers to: a page has them once."""

PLAYER = """
(function(){var d=JSON.parse(document.getElementById("episodes").textContent),main=document.querySelector("main"),
bar=document.querySelector(".player");if(!bar||!d.episodes)return;
var pick=bar.querySelector("select"),slide=bar.querySelector("input"),go=bar.querySelector("button"),
say=bar.querySelector("output"),timer=null,ns="http://www.w3.org/2000/svg";
function make(g,name,set){var e=document.createElementNS(ns,name);for(var k in set)e.setAttribute(k,set[k]);
g.appendChild(e)}
function show(){var m=+pick.value,t=+slide.value,q=d.states?d.states[m][t]:null;main.classList.add("playing");
d.panels.forEach(function(curves,p){var g=document.querySelector('.one[data-panel="'+p+'"]');g.textContent="";
curves.forEach(function(c){var all=c.paths[m],way=all.slice(0,t+1),at=way[way.length-1];
make(g,"polyline",{"class":c.role,points:way.map(function(x){return x.join(",")}).join(" ")});
if(c.turns)make(g,"polygon",{"class":c.role,points:"9,0 -6,5 -3,0 -6,-5",transform:"translate("+at.join(" ")+
") rotate("+c.turns[m][t]+")"});
else make(g,"circle",{"class":c.role,cx:at[0],cy:at[1],r:5})})});
document.querySelectorAll(".here").forEach(function(e){e.classList.remove("here")});
if(q!==null)document.querySelectorAll(".state"+q).forEach(function(e){e.classList.add("here")});
say.textContent="step "+t+" of "+(d.lengths[m]-1)+(q===null?"":", automaton in "+d.names[q])+
(t===d.lengths[m]-1?", "+(d.success[m]?"satisfied":"not satisfied"):"")}
function stop(){clearInterval(timer);timer=null;go.textContent="Play"}
function start(){if(+slide.value>=+slide.max)slide.value=0;go.textContent="Pause";
timer=setInterval(function(){if(+slide.value>=+slide.max)stop();else{slide.value=+slide.value+1;show()}},350)}
function load(){stop();slide.max=d.lengths[+pick.value]-1;slide.value=0;show()}
pick.onchange=load;slide.oninput=function(){stop();show()};go.onclick=function(){if(timer)stop();else{start();show()}};
load();main.classList.remove("playing");bar.hidden=false})();
"""
"""Shows one episode step by step: its paths in every panel, and the automaton state in the drawing of the task."""
