// Shapes to choose from, as pictures; a shape that takes an argument is typed below them.
import { h, picture } from "llm-flock-viewer/dom.js";

const SIZE = 52;
const EDGE = 7;

/** Radio buttons with a picture each; a click writes the shape's name into `input`, and marks the one that is there. */
export function shapePictures(shapes, input) {
  const place = h("div", { class: "flock-shapes", role: "radiogroup", "aria-label": "Shape" });
  const family = (name) => name.split(":")[0];
  const mark = () => {
    for (const box of place.querySelectorAll("input")) box.checked = family(box.value) === family(input.value);
  };
  input.addEventListener("input", mark);
  place.append(...shapes.map((shape) => {
    const dots = shape.places.map(([x, y]) => ["circle",
      { cx: EDGE + x * (SIZE - 2 * EDGE), cy: EDGE + y * (SIZE - 2 * EDGE), r: 3, class: "k-fill" }]);
    const drawn = dots.length ? dots : [["text", { x: SIZE / 2, y: SIZE / 2 + 5, class: "k-words", text: "“…”" }]];
    const box = h("input", { type: "radio", name: "flock-shape", value: shape.name });
    box.addEventListener("change", () => {
      input.value = shape.name;
      mark();
    });
    return h("label", { class: "flock-shape", title: `${shape.about}; robots: ${shape.takes}` }, box, picture(SIZE, SIZE, drawn),
      h("span", { text: family(shape.name) }), h("span", { class: "flock-hint", text: shape.takes.split(" (")[0] }));
  }));
  mark();
  return { element: place, mark };
}
