// Every table that has the column is sorted by it. What has no number stands last, whichever way.
{
  const tables = [...document.querySelectorAll("table.scores")];
  const original = new Map(tables.map((table) => [table, [...table.tBodies[0].rows]]));

  const compare = (index, sign) => (a, b) => {
    const [left, right] = [a.cells[index].dataset, b.cells[index].dataset];
    if ("text" in left) return sign * left.text.localeCompare(right.text, "en", { numeric: true });
    if (!("value" in left) || !("value" in right)) return ("value" in right) - ("value" in left);
    return sign * (Number(left.value) - Number(right.value));
  };

  const sort = () => {
    const column = state.get("sort");
    for (const table of tables) {
      const heads = [...table.tHead.rows[0].cells];
      const index = heads.findIndex((head) => head.dataset.column === column);
      const rows = [...original.get(table)];
      heads.forEach((head) => head.removeAttribute("aria-sort"));
      if (index >= 0) {
        const up = state.get("order") ? state.get("order") === "up" : bestFirst(heads[index]) === "up";
        rows.sort(compare(index, up ? 1 : -1));
        heads[index].setAttribute("aria-sort", up ? "ascending" : "descending");
      }
      table.tBodies[0].append(...rows);
    }
  };

  // Names from a to z, scores from the best.
  const bestFirst = (head) => (head.dataset.column === "method" || head.dataset.better === "down" ? "up" : "down");

  for (const table of tables) {
    for (const head of table.tHead.rows[0].cells) {
      head.querySelector("button").addEventListener("click", () => {
        const sorted = head.getAttribute("aria-sort");
        const order = sorted ? (sorted === "ascending" ? "down" : "up") : bestFirst(head);
        state.set({ sort: head.dataset.column, order });
        sort();
      });
    }
  }
  state.onRead(sort);
}
