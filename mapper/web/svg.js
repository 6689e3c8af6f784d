// Elements of SVG, made in one expression.

const NAMESPACE = "http://www.w3.org/2000/svg";

/** Make an element; `attributes` as SVG has them. */
export function draw(name, attributes = {}, ...children) {
  const made = document.createElementNS(NAMESPACE, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}
