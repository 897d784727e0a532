// Filters the cards of the gallery by what their last line says: agents, states, dynamics, tier, and by the bound.
document.addEventListener("DOMContentLoaded", function () {
  var home = document.querySelector("#cards > .table-wrapper");
  if (!home) return;
  function number(text, pattern) { var m = text.match(pattern); return m ? +m[1] : NaN; }
  var cards = Array.from(home.querySelectorAll("tbody tr")).map(function (row) {
    var text = row.textContent;
    return { row: row, agents: number(text, /(\d+) agents?,/), states: number(text, /, (\d+) states? each/),
             tier: (text.match(/, ((?:solved|open|hard|unrated| and )+),/) || [])[1] || "",
             dynamics: /, nonlinear,/.test(text) ? "nonlinear" : "linear",
             domain: (text.match(/(Robots|Deliveries|Vehicles|Plants|Scaling),/) || [])[1],
             // From .99 on a card says the failure.
             bound: /failure <=/.test(text) ? 1 : number(text, /P >= ([\d.]+)/) };
  });
  var within = function (key, low, high) { return function (c) { return c[key] >= low && c[key] <= high; }; };
  var all = function () { return true; };
  var of = function (domain) { return function (c) { return c.domain === domain; }; };
  var kinds = {
    domain: { any: all, robots: of("Robots"), deliveries: of("Deliveries"), vehicles: of("Vehicles"), plants: of("Plants"),
              scaling: of("Scaling") },
    agents: { any: all, one: within("agents", 1, 1), "2 to 4": within("agents", 2, 4), "5 and more": within("agents", 5, 1e9) },
    "states of an agent": { any: all, one: within("states", 1, 1), two: within("states", 2, 2), "3 and more": within("states", 3, 1e9) },
    dynamics: { any: all, linear: function (c) { return c.dynamics === "linear"; },
                nonlinear: function (c) { return c.dynamics === "nonlinear"; } },
    "left to learn": { any: all, open: function (c) { return c.tier.includes("open"); },
                       hard: function (c) { return c.tier.includes("hard"); }, solved: function (c) { return c.tier.includes("solved"); },
                       unrated: function (c) { return c.tier.includes("unrated"); } },
    "certified": { any: all, "above .99": function (c) { return c.bound > .99; },
                   ".5 to .99": within("bound", .5, .99), "below .5": function (c) { return !(c.bound >= .5); } }
  };
  var bar = document.createElement("div"), said = document.createElement("output"), picks = [];
  bar.className = "gallery-filter";
  Object.keys(kinds).forEach(function (kind) {
    var label = document.createElement("label"), pick = document.createElement("select");
    // What no card is, or all are, is no choice.
    Object.keys(kinds[kind]).forEach(function (name) {
      if (cards.some(kinds[kind][name])) pick.add(new Option(name, name));
    });
    pick.name = kind; label.append(kind, pick); picks.push(pick);
    if (pick.options.length > 2) bar.append(label);
    pick.addEventListener("change", show);
  });
  bar.append(said); home.before(bar);
  function show() {
    var shown = 0;
    cards.forEach(function (card) {
      var fits = picks.every(function (pick) { return kinds[pick.name][pick.value](card); });
      card.row.hidden = !fits; shown += fits;
    });
    said.textContent = shown + " of " + cards.length;
  }
  show();
});
