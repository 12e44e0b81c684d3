"""The pages of a study and of a campaign."""
