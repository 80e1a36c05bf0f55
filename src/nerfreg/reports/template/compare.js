// Two methods on one view, one beside the other, with a border that can be moved.
{
  const section = document.getElementById("compare");
  if (section) {
    const choice = (name) => section.querySelector(`[name=${name}]`);
    const slider = section.querySelector(".slider");
    const images = [...document.querySelectorAll("img[data-view]")];
    const of = (view, kind) => images.filter((image) => image.dataset.view === view && image.dataset.kind === kind);
    const names = ["view", "show", "left", "right"];

    const choose = (select, value, otherwise) => {
      const values = [...select.options].map((option) => option.value);
      select.value = values.includes(value) ? value : values.includes(otherwise) ? otherwise : values[0];
    };

    const offer = (select, methods, otherwise) => {
      const before = state.get(select.name) ?? select.value;
      select.replaceChildren(...methods.map((method) => new Option(method, method)));
      choose(select, before, otherwise);
    };

    const show = () => {
      const view = choice("view").value;
      const methods = of(view, "colour").map((image) => image.dataset.method);
      offer(choice("left"), methods, methods[1]);
      offer(choice("right"), methods, methods.at(-1));
      for (const side of ["left", "right"]) {
        const method = choice(side).value;
        const find = (kind) => of(view, kind).find((image) => image.dataset.method === method);
        const source = find(choice("show").value) ?? find("colour");
        const image = slider.querySelector(`img.${side}`);
        image.src = source.src;
        image.alt = source.alt;
        slider.style.setProperty("--aspect", parseFloat(source.style.aspectRatio));
        slider.querySelector(`.tag.${side}`).textContent = method;
      }
    };

    const move = (value) => slider.style.setProperty("--split", `${value}%`);

    const read = () => {
      choose(choice("view"), state.get("view"), choice("view").value);
      choose(choice("show"), state.get("show"), choice("show").value);
      show();
      const split = Number(state.get("split") ?? choice("split").value);
      if (split >= 0 && split <= 100) choice("split").value = split;
      move(choice("split").value);
    };

    for (const name of names) {
      choice(name).addEventListener("change", () => {
        state.set({ [name]: choice(name).value });
        show();
      });
    }
    choice("split").addEventListener("input", (event) => move(event.target.value));
    choice("split").addEventListener("change", (event) => state.set({ split: event.target.value }));
    state.onRead(read);
    if (state.get("view") || state.get("split")) section.scrollIntoView({ behavior: "instant" });
  }
}
