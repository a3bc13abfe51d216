"""From sound to visemes. Linear prediction and the vowel network join with their own issue."""
