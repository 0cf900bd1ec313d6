"""Which of the places that can be grasped an operator prefers, among those that are likely to be lifted."""
