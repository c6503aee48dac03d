// What is wrong, and what to do next.

export function panel(app, element) {
  element.view = {};
  return element.view;
}
