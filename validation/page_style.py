"""The style sheet of a report; light and dark."""

STYLE = """
:root{--ink:#1b2430;--soft:#5b6775;--paper:#fbfbf9;--card:#fff;--line:#dfe3e8;--bound:#1f5fae;--run:#c2571a;
--bad:#b3261e;--good:#1e7d4f;--region:#e9b949}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#9aa6b4;--paper:#14181e;--card:#1c222a;--line:#313a45;
--bound:#7db2ef;--run:#f0a06b;--bad:#ff8a80;--good:#74d3a2;--region:#8d6d1d}
}*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,
sans-serif}
main{max-width:1120px;margin:0 auto;padding:20px 16px 48px}h1{font-size:1.5rem;margin:0}
h2{font-size:1.05rem;margin:0 0 6px}p{margin:4px 0}.soft{color:var(--soft);font-size:.86rem}
.grid{display:grid;gap:14px;margin-top:16px;grid-template-columns:repeat(auto-fit,minmax(min(330px,100%),1fr))}
section{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:14px;min-width:0}
.wide{grid-column:1/-1}
.verdict{display:inline-block;padding:2px 12px;border-radius:14px;font-weight:600;color:#fff;background:#3f566f}
.confirmed{background:#1a6e45}.refuted{background:#a3211a}.big{font-size:1.35rem;font-weight:600}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 14px;margin:6px 0}dt{color:var(--soft)}
dd{margin:0;overflow-wrap:anywhere}table{border-collapse:collapse;width:100%;font-size:.86rem}
th,td{text-align:left;padding:3px 10px 3px 0;border-top:1px solid var(--line);vertical-align:top;
overflow-wrap:anywhere}
code,pre{font:.82rem/1.45 ui-monospace,Menlo,Consolas,monospace}
pre{overflow-x:auto;white-space:pre-wrap;overflow-wrap:anywhere;margin:4px 0}.scroll{overflow-x:auto}
svg{width:100%;height:auto;display:block}svg text{font:11px system-ui,sans-serif;fill:var(--ink)}
svg .tick{font-size:10px;fill:var(--soft)}svg .name{fill:var(--soft)}.middle{text-anchor:middle}
.end{text-anchor:end}.grid line,line.grid{stroke:var(--line);stroke-width:1}polyline,.arrow{fill:none}
.bound{stroke:var(--bound);stroke-width:2}.bound-dot{fill:var(--bound)}.estimate{stroke:var(--run);stroke-width:1.5}
.estimate-dot{fill:var(--run)}.bad-dot{fill:var(--bad)}.cell{fill:var(--bound)}.over{fill:var(--bound)}.under{fill:var(--run)}
.bad-cell{fill:var(--bad)}
.sure-dot{fill:var(--good);stroke:var(--card);stroke-width:.4}
.region{fill:var(--region);fill-opacity:.22;stroke:var(--region);stroke-width:1}
svg .region-name{font-size:9px;fill:var(--soft)}.path{stroke-width:1;stroke-opacity:.55}
.path.lost{stroke-dasharray:3 2}circle.path{fill-opacity:.8;stroke:none}.agent0{stroke:var(--bound)}
.agent1{stroke:var(--run)}.agent2{stroke:var(--good)}.agent3{stroke:#8a4fb0}.agent4{stroke:#b0902a}.agent5{stroke:#c24c7a}
circle.agent0{fill:var(--bound)}circle.agent1{fill:var(--run)}circle.agent2{fill:var(--good)}circle.agent3{fill:#8a4fb0}
circle.agent4{fill:#b0902a}circle.agent5{fill:#c24c7a}
.state,.accepting,.dead{fill:var(--card);stroke:var(--ink);stroke-width:1.3}
.accepting{stroke:var(--good);stroke-width:1.8}.dead{stroke:var(--bad)}svg .state-name{font-size:10px}
.arrow{stroke:var(--soft);stroke-width:1.1}.tip{fill:var(--soft)}
.key{display:inline-block;width:.75em;height:.75em;border-radius:2px;margin-right:4px}
"""
