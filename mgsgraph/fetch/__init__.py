"""From the id of an image to a folder with all that its adjustment needs, out of the public archives."""
