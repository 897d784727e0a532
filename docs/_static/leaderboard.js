// Colours the probabilities of the leaderboard: the stronger, the larger. Rows and columns stay as they are.
document.addEventListener("DOMContentLoaded", function () {
  document.querySelectorAll("article table").forEach(function (table) {
    var heads = Array.from(table.querySelectorAll("thead th")).map(function (th) { return th.textContent.trim(); });
    if (heads[1] !== "proved" || heads[3] !== "tier") return;
    table.querySelectorAll("tbody tr").forEach(function (row) {
      var failures = /failure/.test(row.cells[1].textContent);
      Array.from(row.cells).slice(1).forEach(function (cell, k) {
        if (k === 2 || k === 3) return;
        var value = parseFloat(cell.textContent.replace(/^[^\d]*/, ""));
        if (k < 2 && failures) value = 1 - value;
        if (!(value >= 0 && value <= 1)) return;
        // What is proved is blue, what was measured green; the length of the bar is the number, too.
        cell.style.setProperty("--share", (100 * value).toFixed(1) + "%");
        cell.classList.add("share", k ? "measured" : "proved");
      });
    });
  });
});
