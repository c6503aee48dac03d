"""What an adjustment leaves behind: tables, words, figures and the archive, in a folder that appears whole or not at all."""
