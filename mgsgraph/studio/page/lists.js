// Points, images, passes and profiles as tables.

export function panel(app, element) {
  element.view = {};
  return element.view;
}
