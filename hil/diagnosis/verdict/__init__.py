"""The answer: verdict, findings and what stands against them, in the words and numbers of docs/generated/json.md."""
