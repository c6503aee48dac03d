"""What an adjustment leaves: tables, words, figures and the archive, in a folder that is there whole or not at all."""
